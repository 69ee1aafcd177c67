"""An array of inertial sensors: where its accelerometers are."""
