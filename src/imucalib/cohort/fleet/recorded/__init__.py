"""A fleet of finished calibrations: worn sensors and arrays, several recordings a device."""
