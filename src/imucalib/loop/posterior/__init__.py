"""One posterior over what a calibration may lack: components, their evidence, and the words."""
