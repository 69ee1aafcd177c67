"""The closed loop of data in order of time: a bias that wanders is noise, not a rival."""
