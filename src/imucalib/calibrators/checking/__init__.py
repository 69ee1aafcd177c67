"""A sensor that has a calibration: does it still hold?"""
