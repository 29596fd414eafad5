"""The use cases. Each is one function and one writing transaction; none knows HTTP or SQL.

models.py       registration of a model, jobs
rotors.py       rotors, their blades, retry
policy.py       what a rotor does by itself, decided anew
inspections.py  readings, corrections, retractions, the list of what counts
diagnoses.py    effects that a model lacks, looked for
adoptable.py    whether a diagnosis may be adopted
adoptions.py    effects into a rotor's model, and out of it
transfer_out.py a rotor out to a file
transfer_in.py  a rotor in from one; transfer_lines.py checks the lines
reads.py        posterior and prediction, with what they rest on
questions.py    what a prediction is asked for, checked against the model
keys.py         API keys: made, listed, revoked, recognised
audit.py        who changed what
"""
