"""Gates on rates: how often one fails by chance, and which rate it would see."""
