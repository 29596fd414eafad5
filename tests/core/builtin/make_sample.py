"""Take the small sample of test runs that `test_rotor_blade.py` compares the artefact with.

    python tests/core/builtin/make_sample.py ARCHIVE

writes ``test_runs.npz`` beside this file: inputs and elongation curves of the 34 test runs, and
CEEQ and permanent deformation at 50 nodes and 6 instants. The nodes are the named ones, in each
run the node of the largest final CEEQ, and others at equal steps.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from core.archive import Archive
from core.builtin.plans import TEST, TRAINING

NODES = 50
INSTANTS = (1, 8, 15, 21, 34, 53)
SAMPLE = Path(__file__).with_name("test_runs.npz")


def main(directory: str) -> None:
    """Write the sample of the archive in `directory`."""
    archive = Archive.open(directory)
    indices = range(TRAINING, TRAINING + TEST)
    ceeq = archive.stack("ceeq", indices)
    worst = ceeq[:, -1].argmax(axis=1)
    chosen = set(worst.tolist()) | set(archive.declaration.named.values())
    others = [
        int(k) for k in np.linspace(0, ceeq.shape[2] - 1, NODES).round() if int(k) not in chosen
    ]
    nodes = np.array(sorted([*chosen, *others[: NODES - len(chosen)]]))
    instants = list(INSTANTS)
    deformation = []
    for index in indices:
        moved = archive.stack("displacement", [index])[0].astype(float)
        deformation.append((moved[instants] - moved[0])[:, nodes])
    np.savez_compressed(
        SAMPLE,
        inputs=archive.inputs(indices),
        time_h=np.array(archive.declaration.time_h),
        elongation=archive.stack("elongation", indices),
        nodes=nodes,
        worst=worst,
        instants=np.array(instants),
        ceeq=ceeq[:, instants][:, :, nodes].astype("f4"),
        deformation=np.array(deformation, dtype="f4"),
    )


if __name__ == "__main__":
    main(sys.argv[1])
