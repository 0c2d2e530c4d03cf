"""Pool the cost ratios of several sets of courses, each given with its 95 % interval.

    python -m experiments.closed_loop_table.pooled 0.83,0.64,1.04 0.88,0.71,1.05 0.91,0.77,1.08 0.83,0.69,0.94

Fixed-effect meta-analysis: logarithms of the ratios are averaged with the inverse of their variances, which are read
off the intervals as if these were normal.
"""

import argparse
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

NORMAL: Final = 1.959964
"""Half the width of a 95 % interval, in standard deviations."""


class Ratio(NamedTuple):
    """A ratio with the ends of its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def log_error(self) -> float:
        """Standard deviation of its logarithm."""
        return (math.log(self.high) - math.log(self.low)) / (2 * NORMAL)


def pooled(ratios: Sequence[Ratio]) -> Ratio:
    """Return the ratio of all sets together."""
    weights = [ratio.log_error**-2 for ratio in ratios]
    total = math.fsum(weights)
    mean = math.fsum(w * math.log(ratio.value) for w, ratio in zip(weights, ratios, strict=True)) / total
    half = NORMAL / math.sqrt(total)
    return Ratio(*(math.exp(mean + end) for end in (0, -half, half)))


def _ratio(text: str) -> Ratio:
    try:
        ratio = Ratio(*map(float, text.split(",")))
    except (TypeError, ValueError):
        raise argparse.ArgumentTypeError(f"'{text}' is not RATIO,LOW,HIGH") from None
    if not 0 < ratio.low < ratio.value < ratio.high < math.inf:
        raise argparse.ArgumentTypeError(f"'{text}' does not rise from LOW over RATIO to HIGH, above 0")
    return ratio


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the pooled difference in percent."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("ratios", nargs="+", type=_ratio, metavar="RATIO,LOW,HIGH", help="as 0.83,0.64,1.04")
    result = pooled(parser.parse_args(arguments).ratios)
    value, low, high = (100 * (each - 1) for each in result)
    print(f"{value:+.0f} % [{low:+.0f}, {high:+.0f}]")  # noqa: T201


if __name__ == "__main__":
    main()
