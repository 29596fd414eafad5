"""A rotor's calibrated model by the UM-Bridge protocol 1.0, for samplers and designs of others.

protocol.py  requests and answers, without a connection
models.py    what is served: each quantity as a function of the parameters, and as predicted
app.py       the same over HTTP, for programs of this machine
"""
