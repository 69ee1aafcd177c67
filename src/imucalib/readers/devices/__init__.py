"""What wearable devices deliver, one file a device."""
