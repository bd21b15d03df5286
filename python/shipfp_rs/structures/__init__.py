"""Parametric models of the drive train: parameters, outputs, equations."""
