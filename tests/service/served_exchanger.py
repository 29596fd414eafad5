"""The exchanger served by UM-Bridge's own package: ``python served_exchanger.py PORT LIMIT``.

It refuses to run at roughnesses above the limit, as simulations fail; each run writes a line.
"""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

import numpy as np
import umbridge
from umbridge import um

from tests.exchanger import TIME_H, drop, transfer


class Exchanger(umbridge.Model):  # type: ignore[misc]
    """Inputs [[roughness], [rate]]; outputs [drop (9), transfer (9)]."""

    def __init__(self, limit: float) -> None:
        super().__init__("exchanger")
        self.limit = limit

    def get_input_sizes(self, config: Any) -> list[int]:
        return [1, 1]

    def get_output_sizes(self, config: Any) -> list[int]:
        return [len(TIME_H)] * 2

    def supports_evaluate(self) -> bool:
        return True

    def __call__(self, parameters: Any, config: Any) -> Any:
        x = np.array([block[0] for block in parameters])
        print(x.tolist(), flush=True)
        if x[0] > self.limit:
            raise ValueError("no convergence")
        return [drop(x, TIME_H).tolist(), (config.get("scale", 1) * transfer(x, TIME_H)).tolist()]


if __name__ == "__main__":
    um.web.run_app = partial(um.web.run_app, host="127.0.0.1", print=None)
    umbridge.serve_models([Exchanger(float(sys.argv[2]))], int(sys.argv[1]))
