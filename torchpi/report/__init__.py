"""Figures and pages. They only draw results; every number on them was computed elsewhere."""

from torchpi.report.page import write_loop_report, write_training_report
from torchpi.report.training import RecordFit, Saturation, TrainingReport, WeightsAgainstRate
from torchpi.report.what_was_run import Provenance, provenance

__all__ = [
    "Provenance",
    "RecordFit",
    "Saturation",
    "TrainingReport",
    "WeightsAgainstRate",
    "provenance",
    "write_loop_report",
    "write_training_report",
]
