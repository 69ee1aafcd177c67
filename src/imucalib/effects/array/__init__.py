"""Effects that only a moving array shows: gyros, clocks, and where in a package the axes sense."""
