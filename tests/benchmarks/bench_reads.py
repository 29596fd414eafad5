"""Reads of a prediction a second: kept bytes, the same with an ETag, and computed anew.

    python tests/benchmarks/bench_reads.py [READS] [CONNECTIONS]

A real server (`bladetwin serve`) on SQLite and the loopback, a rotor of 100 blades with the blade
physics. READS requests for one blade's prediction, over CONNECTIONS connections that stay open, one
request after the other on each; the client writes prepared bytes and looks at status and length
alone, so that it takes little of the other processor. Then the same from a server that keeps no
answers (BLADETWIN_ANSWERS_MB=0).
"""

from __future__ import annotations

import socket
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from service.client import Client
from service.free_port import free_port
from service.settings import Settings
from service.studies.load.run import serving
from service.studies.load.watch import family, processor_s
from tests.benchmarks.bench_update import NAMES, elongations

PATH = "/v1/rotors/r/blades/{}/prediction?quantity=elongation&times=8000,24000,50000"


def asked(port: int, tag: str | None, reads: int, connections: int) -> tuple[float, list[float]]:
    """(seconds, latencies) of so many requests; every answer has to be what was asked for."""
    lines = [f"GET {PATH.format(NAMES[3])} HTTP/1.1", f"Host: 127.0.0.1:{port}"]
    lines += [f"If-None-Match: {tag}"] if tag else []
    request = "\r\n".join([*lines, "", ""]).encode()
    status = b"HTTP/1.1 304" if tag else b"HTTP/1.1 200"
    took: list[float] = []

    def one(count: int) -> None:
        with socket.create_connection(("127.0.0.1", port)) as link:
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for _ in range(count):
                begun = time.perf_counter()
                link.sendall(request)
                answer = link.recv(65536)
                while b"\r\n\r\n" not in answer:
                    answer += link.recv(65536)
                head, _, body = answer.partition(b"\r\n\r\n")
                length = 0
                if not tag:
                    length = int(head.lower().split(b"content-length:")[1].split(b"\r\n")[0])
                while len(body) < length:
                    body += link.recv(65536)
                assert head.startswith(status), head[:200]
                took.append(time.perf_counter() - begun)

    threads = [
        threading.Thread(target=one, args=(reads // connections,)) for _ in range(connections)
    ]
    begun = time.perf_counter()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return time.perf_counter() - begun, took


def measured(answers_mb: float, reads: int, connections: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings.load(
            {},
            database_url=f"sqlite:///{folder}/b.db",
            port=free_port(),
            answers_mb=answers_mb,
            log_level="warning",
            diagnosers=0,
        )
        url = f"http://127.0.0.1:{settings.port}"
        with serving(settings, Path(folder) / "log") as server, Client(url) as client:
            client.ready(60)
            client.create_rotor("r", blades=NAMES, particles=10_000)
            readings = [
                {"id": r.id, "blade": r.blade, "quantity": "elongation", "time_h": r.time_h,
                 "value": float(r.values[0])} for r in elongations(1)
            ]  # fmt: skip
            client.wait_for("r", client.post_inspections("r", readings))
            client.wait_sealed("r")
            tag = client._http.get(
                PATH.format(NAMES[3]), headers={"Accept-Encoding": "identity"}
            ).headers["etag"]
            for name, given in (("ETag known", tag), ("whole answer", None)):
                asked(settings.port, given, 200, connections)
                api = family(server.pid)["api"]
                before = processor_s(api) or 0.0
                seconds, took = asked(settings.port, given, reads, connections)
                used = (processor_s(api) or 0.0) - before
                ms = 1e3 * np.array(took)
                print(
                    f"{'kept' if answers_mb else 'computed anew'}, {name}: "
                    f"{len(took) / seconds:.0f} reads/s, median {np.median(ms):.1f}, 99th "
                    f"percentile {np.percentile(ms, 99):.1f} ms; {1e3 * used / len(took):.2f} ms "
                    "of the server's processor each",
                    flush=True,
                )


if __name__ == "__main__":
    words = sys.argv[1:] + ["10000", "4"][len(sys.argv) - 1 :]
    measured(64.0, int(words[0]), int(words[1]))
    measured(0.0, int(words[0]) // 10, int(words[1]))
