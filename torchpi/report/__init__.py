"""Figures and pages. They read results and draw; every number on them was computed elsewhere."""

from torchpi.report.diagnosis_events import write_tensorboard
from torchpi.report.diagnosis_figures import diagnosis_figures
from torchpi.report.diagnosis_json import diagnosis_json
from torchpi.report.diagnosis_page import write_diagnosis
from torchpi.report.page import write_loop_report, write_training_report
from torchpi.report.training import RecordFit, Saturation, TrainingReport, WeightsAgainstRate
from torchpi.report.what_was_run import Provenance, provenance

__all__ = [
    "Provenance",
    "RecordFit",
    "Saturation",
    "TrainingReport",
    "WeightsAgainstRate",
    "diagnosis_figures",
    "diagnosis_json",
    "provenance",
    "write_diagnosis",
    "write_loop_report",
    "write_tensorboard",
    "write_training_report",
]
