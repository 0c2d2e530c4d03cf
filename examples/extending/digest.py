"""A command from outside: `offpiste digest LOG` prints the length of a log and a hash of its numbers.

    OFFPISTE_EXTENSIONS=digest PYTHONPATH=examples/extending offpiste digest drive.csv

A file like this one in `src/offpiste/cli/` is found by itself.
"""

import hashlib
from dataclasses import dataclass

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.core.progress import show


@COMMANDS.register("digest")
@dataclass(frozen=True)
class Digest:
    """Print the length of a log and a hash of its numbers, to tell copies from look-alikes."""

    log: tyro.conf.Positional[str]
    """A log in any format that offpiste reads."""

    def run(self) -> int:
        """Read every topic, add it to the hash, print."""
        from offpiste import open_log

        log = open_log(self.log)
        digest, first, last = hashlib.sha256(), float("inf"), float("-inf")
        for topic in log.topics.values():
            if topic.count and topic.fields:
                samples = log.read(topic.name, topic.fields)
                digest.update(samples.time.tobytes() + samples.values.tobytes())
                first, last = min(first, *samples.time), max(last, *samples.time)
        show(f"{last - first:.1f} s  {digest.hexdigest()[:16]}  {self.log}")
        return 0
