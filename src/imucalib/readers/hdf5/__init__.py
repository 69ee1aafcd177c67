"""HDF5 recordings."""
