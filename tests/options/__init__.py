"""Every option of every command, with a case that shows what it changes and what it leaves."""
