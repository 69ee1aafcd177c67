"""What commands have in common: options, how a calibrator runs, what is printed, failures."""
