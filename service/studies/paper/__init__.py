"""The paper's example, remade: four calibrations, every figure of its Sec. 4, its statements
beside ours.

    numbers     what one calibration foresees, and how far off that is
    scans       the same of blade 01's scans
    run         the calibrations in processes of their own
    statements  what the paper says, held against these numbers
    plots       the figures;  page: one HTML file of it all, with its tables
    commands    `bladetwin study paper`

The science is `core.validation.paper`; nothing here is calibrated.
"""
