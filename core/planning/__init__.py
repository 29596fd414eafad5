"""Which inspection next, and what it would tell.

ahead   inspections that could be made, and what a calibrated model expects them to read
worth   by how much they would narrow a quantity of interest

Which of them would tell rival hypotheses apart: `core.diagnosis.separate`.
"""
