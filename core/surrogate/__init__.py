"""Surrogate of simulation runs: train on an archive, predict, compile, save, load."""

from core.surrogate.artefact import load, save
from core.surrogate.model import Surrogate
from core.surrogate.training import train

__all__ = ["Surrogate", "load", "save", "train"]
