"""A cluster that others have started."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import dask
import distributed  # noqa: F401  # brings its settings, which would go with those set for a while
import psutil
import pytest
from processes import PATH_OF_FAULTS
from written import contents

from bridge.batch.batch import Options, plan, run_batch
from bridge.batch.manifest import DONE
from bridge.config import load_config
from netconvert.errors import BatchError, ConfigError

MakeDataSet = Callable[..., list[Path]]
Cluster = tuple[str, list[subprocess.Popen[bytes]]]
BIN = Path(sys.executable).parent
CONFIG = load_config(flags={"request.agents": 5})


@contextlib.contextmanager
def started_cluster(tmp_path: Path, *, protocol: str, settings: dict[str, str], workers: int) -> Iterator[Cluster]:
    """A scheduler and workers as a user starts them by bridge/batch/README.md, each by its own command line."""
    file = tmp_path / "scheduler.json"
    environment = os.environ | {"PYTHONPATH": PATH_OF_FAULTS} | settings
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    here = ["--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0", "--protocol", protocol]
    scheduler = ["scheduler", *here, "--port", "0", "--scheduler-file", str(file)]
    worker = ["worker", *here, "--scheduler-file", str(file), "--nthreads", "1", "--local-directory", str(tmp_path)]
    processes = [subprocess.Popen([str(BIN / "dask"), *scheduler], **quiet)]
    try:
        while not file.exists():
            assert processes[0].poll() is None
            time.sleep(0.1)
        processes += [subprocess.Popen([str(BIN / "dask"), *worker], **quiet) for _ in range(workers)]
        yield json.loads(file.read_text())["address"], processes
    finally:
        for process in reversed(processes):
            process.send_signal(signal.SIGINT)
        for process in processes:
            try:
                process.wait(timeout=60)
            except subprocess.TimeoutExpired:
                process.kill()


@pytest.mark.slow
def test_cluster_that_others_started(make_data_set: MakeDataSet, tmp_path: Path) -> None:
    """`hid2 generate --scheduler` uses its workers, also when one is killed on the way; the bytes are the same."""
    folders = make_data_set(6)
    run_batch(plan(folders, CONFIG), tmp_path / "here", Options(jobs=2))
    command = [str(BIN / "hid2"), "generate", str(folders[0].parent), "-o", str(tmp_path / "there"), "--agents", "5"]
    with started_cluster(tmp_path, protocol="tcp", settings={}, workers=2) as (address, processes):
        generating = subprocess.Popen([*command, "--scheduler", address], stdout=subprocess.PIPE, text=True)
        while not (tmp_path / "there" / "val").exists():
            assert generating.poll() is None
            time.sleep(0.1)
        killed = processes.pop()
        killed.kill()  # the nanny: its worker goes with it
        killed.wait()
        output, _ = generating.communicate(timeout=300)
    assert generating.returncode == 0
    assert "6 of 6 scenes done" in output
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


def certificates(folder: Path) -> dict[str, str]:
    """Dask's settings for a CA and one certificate by it, made on the spot as bridge/batch/README.md says."""
    key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"]
    signed = ["-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2"]
    for arguments in (
        ["req", "-x509", *key, "-keyout", "ca.key", "-out", "ca.pem", "-subj", "/CN=hid2 CA"],
        ["req", *key[:-2], "-keyout", "node.key", "-out", "node.csr", "-subj", "/CN=hid2 cluster"],
        ["x509", "-req", "-in", "node.csr", *signed, "-out", "node.pem"],
    ):
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)
    settings = {"distributed.comm.require-encryption": "True", "distributed.comm.tls.ca-file": str(folder / "ca.pem")}
    for role in ("scheduler", "worker", "client"):
        settings[f"distributed.comm.tls.{role}.cert"] = str(folder / "node.pem")
        settings[f"distributed.comm.tls.{role}.key"] = str(folder / "node.key")
    return settings


@pytest.mark.slow
def test_cluster_with_certificates_serves_those_who_have_one(make_data_set: MakeDataSet, tmp_path: Path) -> None:
    settings = certificates(tmp_path)
    environment = {f"DASK_{key.replace('.', '__').replace('-', '_').upper()}": text for key, text in settings.items()}
    jobs = plan(make_data_set(2), CONFIG)
    with started_cluster(tmp_path, protocol="tls", settings=environment, workers=1) as (address, processes):
        assert address.startswith("tls://127.0.0.1:")
        options = Options(scheduler=address, function="faults:copies")
        with dask.config.set(settings):
            rows = run_batch(jobs, tmp_path / "out", options)
        assert [row.status for row in rows] == [DONE, DONE]
        with pytest.raises(
            ConfigError, match=r"scheduler 'tls://.*': no certificates for it, expected Dask's settings"
        ):
            run_batch(jobs, tmp_path / "other", options)
        with pytest.raises(BatchError, match="cannot be reached"):
            run_batch(jobs, tmp_path / "other", replace(options, scheduler=address.replace("tls", "tcp")))
        family = [psutil.Process(p.pid) for p in processes]
        family += [child for process in family for child in process.children(recursive=True)]
        listening = {c.laddr.ip for p in family for c in p.net_connections("inet") if c.status == psutil.CONN_LISTEN}
        assert listening == {"127.0.0.1"}
