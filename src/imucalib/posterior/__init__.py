"""What is likely of what a model lacks: one posterior of every calibrator."""
