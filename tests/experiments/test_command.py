"""The command line of the experiments."""

import logging
from dataclasses import dataclass

import pytest

from experiments.command import run
from experiments.unseen_kinds import UnseenKinds


@dataclass(frozen=True)
class Greeting:
    """An experiment."""

    name: str = "nobody"

    def run(self) -> str:
        """Log a message and return a result."""
        logging.getLogger("experiments").info(f"looking for {self.name}")
        return f"found {self.name}"


def test_messages_and_the_result_are_printed(capsys):
    run(Greeting, ["--name", "Ada"])
    assert capsys.readouterr().out.splitlines() == ["looking for Ada", "found Ada"]


def test_settings_of_an_experiment_are_its_options(capsys):
    with pytest.raises(SystemExit):
        run(UnseenKinds, ["--help"])
    assert "--reproduction PATH" in capsys.readouterr().out
