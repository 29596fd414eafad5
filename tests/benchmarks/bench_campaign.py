"""The 66 training runs of the rotor blade, as `bladetwin model build` makes them.

    python tests/benchmarks/bench_campaign.py FOLDER [RUNS] [WORKERS] [MESH]

FOLDER is that of a new model: the runs go to FOLDER/archive, so that `bladetwin model build
rotor-blade --out FOLDER` goes on from there. Prints wall and processor time, the largest memory of
a worker process, and the size of the archive.
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

from core.builtin import plans, rotor_blade
from service.progress import bar


def main(folder: Path, runs: int, workers: int, mesh: str) -> None:
    """Run and print."""
    points = plans.design(plans.SEED, plans.TRAINING, plans.TEST)[:runs]
    archive = rotor_blade.open_archive(folder / "archive", mesh)
    before = len(archive.done())
    start = time.monotonic()
    with bar("runs", runs) as shown:
        rotor_blade.simulate(
            archive, points, workers=workers, progress=lambda _name, done, _n, _left: shown(done)
        )
    wall = time.monotonic() - start
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    size = sum(file.stat().st_size for file in archive.path.rglob("*") if file.is_file())
    print(
        f"{runs - before} runs, {workers} processes: {wall / 60:.1f} min wall, "
        f"{(used.ru_utime + used.ru_stime) / 60:.1f} min processor time, "
        f"{used.ru_maxrss / 1024:.0f} MB at most per process, archive {size / 2**20:.0f} MiB"
    )


if __name__ == "__main__":
    words = [*sys.argv[1:], *["", "66", "2", "default"][len(sys.argv) - 1 :]]
    if not words[0]:
        raise SystemExit(
            "bench_campaign.py FOLDER [RUNS] [WORKERS] [MESH]: name a folder for the model"
        )
    main(Path(words[0]), int(words[1]), int(words[2]), words[3])
