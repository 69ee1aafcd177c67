"""Effects that show in what a sensor at rest says of the size of gravity, over many postures."""
