"""Whether a log fits the board file: axes and places, before anything is fitted."""
