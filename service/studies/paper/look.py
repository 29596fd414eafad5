"""Colours of the paper's figures: without the discrepancy, with it, after each outage."""

from __future__ import annotations

from service.studies.plots import BAND, INK

WITH, WITH_BAND, RED, GREY = "#b8500f", "#f2d3ba", "#c0392b", "#777777"
COLOURS = {False: (INK, BAND), True: (WITH, WITH_BAND)}
SHADES = ("#9db4d3", "#5578a8", "#12294a"), ("#e9b48e", "#cf7a3a", "#7a3206")  # outages 1, 2, 3
SAYS = {False: "without δ", True: "with δ"}
