"""Diagnosis of missing physics: where simulation and recordings differ, why, and a better simulation."""

from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import Diagnosis

__all__ = ["Diagnosis", "diagnose"]
