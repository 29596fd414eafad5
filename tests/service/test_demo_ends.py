"""The main job, told to end, takes its service with it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.patience import PATIENCE_S

SCRIPT = """
import sys, time
from pathlib import Path
from service.demo.run import service
with service(Path(sys.argv[1])) as running:
    print(running.process.pid, flush=True)
    time.sleep(3600)
"""


def test_a_main_job_that_is_terminated_leaves_no_service(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(tmp_path)], stdout=subprocess.PIPE
    ) as job:
        assert job.stdout is not None
        server = int(job.stdout.readline())
        assert Path(f"/proc/{server}").exists()
        time.sleep(0.5)
        job.send_signal(signal.SIGTERM)
        assert job.wait(PATIENCE_S) == 143
    try:
        os.kill(server, 0)
    except ProcessLookupError:
        return
    os.kill(server, signal.SIGKILL)
    raise AssertionError("the service outlived the job that started it")
