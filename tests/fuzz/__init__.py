"""Bad input at scale: mutated logs, rigs, datasets, runs and more, each given to a command in a process of its own."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))  # helpers of the other tests
