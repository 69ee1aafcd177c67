"""Reports of a worn sensor."""
