"""How parameters are estimated."""
