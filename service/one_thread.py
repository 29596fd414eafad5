"""Linear algebra on one thread in every command; imported before anything that imports numpy.

A matrix product that BLAS shares among threads is summed in another order than on one: its last
bits depend on how many processors a machine has. One bit in a reading is another digest, hence
another random stream, and two workers would seal two states. The matrices are small, and
processors are used blade by blade. Children inherit it. A number that is already set stays; it must
then be the same for all workers of a database.
"""

from __future__ import annotations

import os

for name in ("OPENBLAS", "MKL", "BLIS"):
    os.environ.setdefault(f"{name}_NUM_THREADS", "1")
