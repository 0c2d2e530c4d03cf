"""Python processes that start in no time: forks of a server that has imported torch and offpiste."""

import atexit
import json
import os
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

SERVER = """
import json, os, runpy, sys, traceback
import offpiste.cli.entry
for name, value in offpiste.cli.entry.LIBRARIES.items():
    os.environ.setdefault(name, value)
import offpiste.dataset.extract, offpiste.evaluation.evaluate_runs, offpiste.inspection.inspect
import offpiste.planning.kernel, offpiste.simulation.simulate, offpiste.training.train

def run(job):
    for number, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(os.path.join(job["folder"], name), os.O_WRONLY | os.O_CREAT), number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.environ.update(job["environment"])
    sys.path[:0] = job["path"]
    words = job["arguments"]
    try:
        if words[0] == "-c":
            sys.argv = ["-c", *words[2:]]
            exec(compile(words[1], "<string>", "exec"), {"__name__": "__main__"})
        elif words[0].endswith(".py"):
            sys.argv = words
            runpy.run_path(words[0], run_name="__main__")
        else:
            offpiste.cli.main(words)
    except SystemExit as exit_:
        return exit_.code or 0 if isinstance(exit_.code, int | None) else 1
    except BaseException:
        traceback.print_exc()
        return 1
    return 0

for line in sys.stdin:
    child = os.fork()
    if child == 0:
        code = 1
        try:
            code = run(json.loads(line))
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@cache
def _server() -> "subprocess.Popen[str]":
    path = os.pathsep.join(filter(None, sys.path))
    server = subprocess.Popen(
        [sys.executable, "-c", SERVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": path},
    )  # fmt: skip
    atexit.register(server.kill)
    return server


def run_warm(
    *arguments: str | Path, path: tuple[Path, ...] = (), **environment: str
) -> "subprocess.CompletedProcess[str]":
    """Run a command of offpiste, `-c SCRIPT` or a file in a fork of the server.

    Args:
        path: folders in front of `sys.path`.
        environment: additional variables.
    """
    server = _server()
    assert server.stdin is not None
    assert server.stdout is not None
    words = [str(word) for word in arguments]
    with tempfile.TemporaryDirectory() as folder:
        job = {"arguments": words, "folder": folder, "path": [str(each) for each in path], "environment": environment}
        server.stdin.write(json.dumps(job) + "\n")
        server.stdin.flush()
        code = int(server.stdout.readline())
        out, err = (Path(folder, name).read_text("utf-8") for name in ("out", "err"))
    return subprocess.CompletedProcess(words, code, out, err)
