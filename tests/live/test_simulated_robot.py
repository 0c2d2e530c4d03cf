"""Vehicle of the proving ground on the transport: its messages, its commands, and its end."""

import threading
from importlib import resources
from unittest.mock import Mock

import numpy as np
import pytest

from cli.command import refusal
from offpiste.closed_loop.courses import choose_course
from offpiste.live import simulated_robot
from offpiste.live.command_messages import joy_message
from offpiste.live.simulated_robot import COURSE, RemoteCommands, SimulatedRobot
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings
from offpiste.transport.received import Received
from offpiste.transport.zenoh_transport import ZenohTransport
from synthetic_drive import samples

WORLD = WorldSettings("dunes", 5, size=200.0, resolution=0.5)


def recorded():
    """Transport that records published messages by topic."""
    transport = Mock(spec=ZenohTransport, sent={})
    transport.publisher.side_effect = lambda topic, *_, **__: transport.sent.setdefault(topic, []).append
    return transport


@pytest.fixture(scope="module")
def place():
    world = make_world(WORLD)
    return world, choose_course(world, WORLD.seed)


def threads():
    return {thread for thread in threading.enumerate() if thread.is_alive() and "_work" in thread.name}


def test_it_publishes_its_messages_and_follows_commands(place, monkeypatch):
    monkeypatch.setattr(simulated_robot, "OWN_STOP", 60.0)  # for a busy machine
    transport, before = recorded(), threads()
    robot = SimulatedRobot(transport, *place, "light", 0)
    transport.decode.return_value = joy_message(0, np.array((0.4, 0.0, 0.1)))
    transport.subscribe.call_args.args[1](Received("/command", "sensor_msgs/msg/Joy", b"", 0.0))
    driving = robot.drive(0.5)
    assert len(driving.samples) == 25
    for topic in ("/odometry", "/clock"):
        assert len(transport.sent[topic]) == 25
    assert len(transport.sent[COURSE][0].poses) == len(place[1].course.driven)
    assert transport.sent["/tf_static"]
    np.testing.assert_allclose(robot.commands.given[0][:3], (0.4, 0.0, 0.1))
    assert threads() == before


def test_the_vehicle_and_the_noise_of_positions_are_options(place, tmp_path):
    file = tmp_path / "heavy.toml"
    shipped = (resources.files("offpiste.simulation.vehicle") / "side_by_side.toml").read_text()
    file.write_text(shipped.replace("\nmass = 1150.0", "\nmass = 2000.0"))
    robot = SimulatedRobot(recorded(), *place, "none", 0, vehicle=str(file), pose_noise=5.0)
    assert robot._parameters.mass == 2000.0
    driven = robot.drive(1.0).samples
    sent = np.array([(m.pose.pose.position.x, m.pose.pose.position.y) for m in robot._transport.sent["/odometry"]])
    assert np.std(sent - [sample.position[:2] for sample in driven]) == pytest.approx(5.0, rel=0.3)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ("--seconds inf", "--seconds: invalid duration inf s"),
        ("--seconds 0", "--seconds: invalid duration 0 s"),
        ("--out a.mcap", "--out would do nothing"),
        ("--drives 2", "--drives would do nothing"),
    ],
)
def test_invalid_options_are_refused(options, what, capsys):
    assert what in refusal(capsys, "simulate", "--live", *options.split())


@pytest.mark.parametrize(
    ("axes", "given"),
    [((0.4, 0.0, 0.1), (0.4, 0.0, 0.1, 1.0)), ((0.4, 0.0, 0.1, -1.0), (0.4, 0.0, 0.1, -1.0))]
    + [(axes, (0.0, 1.0, 0.0, 1.0)) for axes in ((), (0.1,), (np.nan, 0.0, 0.0), (0.1, 0.0, 0.0, np.nan))],
)
def test_a_fourth_axis_is_the_gear_and_invalid_axes_are_ignored(axes, given, monkeypatch):
    monkeypatch.setattr(simulated_robot, "OWN_STOP", 60.0)
    commands = RemoteCommands()
    commands.received(np.array(axes))
    np.testing.assert_allclose(commands.command(samples(0.1)[0]), given)


@pytest.mark.parametrize("after", [0, 7])
def test_an_interrupted_drive_ends_there_and_leaves_no_thread_behind(after, place, monkeypatch):
    before = threads()
    robot = SimulatedRobot(recorded(), *place, "light", 0)

    def interrupted(steps, _):
        yield from steps[:after]
        raise KeyboardInterrupt

    monkeypatch.setattr(simulated_robot, "track", interrupted)
    assert threads() > before
    if after:
        assert len(robot.drive(1.0).samples) == after
    else:
        with pytest.raises(KeyboardInterrupt):
            robot.drive(1.0)
    assert threads() == before
