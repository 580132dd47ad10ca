"""Loaded once, by the process that all processes of a measurement are copies of."""

from runtime.benchmark import bus, log_contenders
from runtime.messages import typestore

__all__ = ["bus", "log_contenders"]
typestore()
