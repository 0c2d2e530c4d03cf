"""`ros2 run offpiste_ros live RIG …`: `offpiste live` by rclpy, with the same arguments.

Options that say how the robot is reached over zenoh (`--endpoint`, `--router`, `--keys`, …) have no effect; the domain
is ROS_DOMAIN_ID, as for every node.
"""

import sys

import tyro

from offpiste.cli.live import Live
from offpiste.core.errors import OffpisteError
from offpiste.core.progress import log_to_terminal
from offpiste_ros.rclpy_transport import RclpySettings


def main(arguments: list[str] | None = None) -> int:
    """Drive, or watch; the exit code: 0 done, 1 something is wrong, said in one line."""
    from rclpy.utilities import remove_ros_args

    given = remove_ros_args(sys.argv if arguments is None else ["live", *arguments])[1:]
    live = tyro.cli(Live, prog="live", args=given, config=(tyro.conf.FlagCreatePairsOff,))
    log_to_terminal()
    try:
        return live.run_on(RclpySettings())
    except OffpisteError as error:
        print(f"offpiste: {error}", file=sys.stderr)  # noqa: T201
        return 1
    except KeyboardInterrupt:
        return 1


if __name__ == "__main__":
    sys.exit(main())
