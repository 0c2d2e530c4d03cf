"""The systemd unit and the container file of a robot."""

import configparser
import json
import re
import shlex
import signal

import pytest
from packaging.requirements import Requirement

from installation.test_dependencies import EXTRAS, PYPROJECT, ROOT, core_dependencies
from offpiste.cli.entry import commands_in_order, parse
from offpiste.core.signals import GROUP_SIGNALS
from offpiste.live.control import ENDS
from offpiste.live.part import AFTER
from offpiste.live.session import RINGS

UNIT, DOCKERFILE = ROOT / "deploy" / "offpiste.service", ROOT / "deploy" / "Dockerfile"
PAGE = (ROOT / "docs" / "install-on-a-robot.md").read_text("utf-8")
INSTALLED = "/opt/offpiste/bin/offpiste"


@pytest.fixture(scope="module")
def unit():
    file = configparser.ConfigParser(interpolation=None, strict=True)
    file.optionxform = str
    file.read_string(UNIT.read_text())
    return file


def test_the_unit_runs_a_command_in_shadow_mode(unit):
    program, *words = shlex.split(unit["Service"]["ExecStart"])
    assert program == INSTALLED
    live = parse(words, commands_in_order())
    assert live.rig == "/etc/offpiste/rig.toml"
    assert not live.drive, "what starts with the computer moves nothing"


def test_the_unit_lets_the_vehicle_be_stopped_and_starts_again(unit):
    service = unit["Service"]
    assert not {"KillSignal", "KillMode"} & set(service), "SIGTERM to all of them ends in a stop"
    assert float(service["TimeoutStopSec"]) > max(AFTER + 2, ENDS + 3 + 3), "processes end, and the stop"
    assert unit["Unit"]["StartLimitIntervalSec"] == "0", "no number of failures is the last"
    assert (service["Restart"], service["OOMPolicy"], service["Type"]) == ("on-failure", "continue", "notify")
    assert "WatchdogSignal" not in service, "SIGABRT, which the processes of a drive ignore"
    assert signal.SIGABRT in GROUP_SIGNALS


def test_each_line_of_the_unit_that_the_page_explains_is_there(unit):
    table = PAGE[PAGE.index("| line | why |") : PAGE.index("**With `--drive`")]
    named = re.findall(r"`([A-Za-z]+=[^`]+)`", table)
    assert len(named) >= 6
    present = {f"{key}={value}" for section in unit.values() for key, value in section.items()}
    assert set(named) <= present


def instructions():
    lines = DOCKERFILE.read_text().replace("\\\n", " ").splitlines()
    return [tuple(line.split(maxsplit=1)) for line in lines if line and not line.startswith("#")]


def test_the_container_installs_what_there_is():
    steps = instructions()
    assert steps[0] == ("FROM", "python:3.12-slim-bookworm")
    known = {"FROM", "WORKDIR", "COPY", "RUN", "ENV", "VOLUME", "ENTRYPOINT", "CMD"}
    assert {name for name, _ in steps} <= known
    project = PYPROJECT["project"]
    copied = {source for name, rest in steps if name == "COPY" for source in rest.split()[:-1]}
    assert all((ROOT / source).exists() for source in copied)
    assert {"pyproject.toml", "src", project["readme"], *project["license-files"]} <= copied, "what the build reads"
    installed = next(rest for name, rest in steps if name == "RUN")
    extras = re.findall(r"\.\[([a-z,]+)\]", installed)[0].split(",")
    assert set(extras) <= set(EXTRAS)
    assert json.loads(dict(steps)["ENTRYPOINT"]) == [next(iter(project["scripts"]))]
    with pytest.raises(SystemExit) as ended:
        parse(["live", *json.loads(dict(steps)["CMD"])], commands_in_order())
    assert ended.value.code == 0


def test_commands_of_the_page_are_understood(monkeypatch):
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    lines = [line.split("#")[0].removeprefix("/opt/offpiste/bin/") for block in blocks for line in block.split("\n")]
    runs = [shlex.split(line) for line in lines if line.startswith(("docker run", "offpiste "))]
    assert {words[0] for words in runs} == {"docker", "offpiste"}
    for words in runs:
        start = words.index("offpiste", 0 if words[0] == "offpiste" else 1)
        parse(words[start + 1 :], commands_in_order())
    memory = next(words[words.index("--shm-size") + 1] for words in runs if "--shm-size" in words)
    assert int(memory.removesuffix("m")) << 20 > sum(slots * size for slots, size in RINGS.values())


def test_the_page_names_every_core_dependency_and_the_extras_of_a_robot():
    wanted = {requirement.name for requirement in core_dependencies()}
    wanted |= {Requirement(text).name for name in ("live", "view", "onnx") for text in EXTRAS[name]}
    table = PAGE[PAGE.index("pure Python") : PAGE.index("| none |")]
    assert wanted <= set(re.findall(r"[a-z][a-z0-9.-]+[a-z0-9]", table)), wanted
