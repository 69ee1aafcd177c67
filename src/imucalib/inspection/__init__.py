"""What a recording holds, without calibrating anything."""
