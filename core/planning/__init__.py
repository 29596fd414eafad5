"""Which inspection next, and what it would tell.

candidates  inspections that could be made
ahead       what a calibrated model expects them to read
campaigns   the same of every blade at once
ready       what has to be compiled for them, for all of their hours together
worth       by how much they would narrow a quantity of interest

Which of them would tell rival hypotheses apart: `core.diagnosis.separate`.
"""
