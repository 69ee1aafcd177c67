"""The motion to record next with an array, so that an ambiguity ends."""
