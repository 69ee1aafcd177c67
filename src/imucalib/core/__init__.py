"""The one equation: parameters, effects, references, observations, model and fit."""
