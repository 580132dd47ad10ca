"""Devices of a cell, real or simulated."""
