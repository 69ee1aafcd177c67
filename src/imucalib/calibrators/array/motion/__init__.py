"""A board in motion: where its accelerometers are and what their model lacks, jointly."""
