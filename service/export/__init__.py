"""Answers as files that other tools read; pure functions of what the use cases give.

netcdf.py    draws, in ArviZ's schema
vtu.py       a field on the model's mesh, for ParaView, PyVista, meshio
tables.py    predictions as CSV
readings.py  readings as CSV rows, which can be posted again, and as Parquet
series.py    fields over hours: PVD with its VTU files, numpy arrays
arrow.py     fields over hours: an Arrow stream
sensorthings.py  readings and predictions as SensorThings entities
units.py     units of parameters by their names
"""
