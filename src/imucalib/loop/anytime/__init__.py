"""Evidence that stays valid while a table grows and is looked at again."""
