"""Exchange with another implementation: zenoh-ros2-sdk publishes like a robot and receives commands."""

import multiprocessing
import os
from contextlib import closing

import numpy as np
import pytest

from live.synthetic_robot import ACKERMANN, cloud, odometry, tree
from offpiste.logs.ros.writer import header, make
from offpiste.simulation.messages import image_message
from offpiste.transport.message_types import MessageTypes
from transport.routers import Network, until


def messages():
    """A message of each kind, by topic."""
    picture = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
    image = image_message(picture, 10**9, "camera")
    return {"/odom": odometry(5.0), "/tf_static": tree(), "/image/compressed": image, "/points": cloud(0.0)}


def other_side(endpoint, publishing, ready, done, heard):
    """Publish like a robot until `done`, and pass on received commands."""
    os.environ["ZENOH_CONFIG_OVERRIDE"] = 'listen/endpoints=["tcp/127.0.0.1:0"]'
    from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber

    types, publishers, port = MessageTypes(), [], int(endpoint.rpartition(":")[2])
    for topic, message in publishing.items():
        name = message.__msgtype__
        publisher = ROS2Publisher(
            topic, name, msg_definition=types.definition(name), type_hash=types.hash_of(name), router_port=port
        )
        publishers.append((publisher, message))

    def command(message):
        heard.put((message.drive.speed, message.drive.steering_angle, message.header.frame_id))

    subscriber = ROS2Subscriber(
        "/drive", ACKERMANN, command, msg_definition=types.definition(ACKERMANN),
        type_hash=types.hash_of(ACKERMANN), router_port=port,
    )  # fmt: skip
    ready.set()
    while not done.wait(0.05):
        for publisher, message in publishers:
            fields = {name: getattr(message, name) for name in message.__dataclass_fields__ if name != "__msgtype__"}
            publisher.publish(**fields)
    assert subscriber is not None
    os._exit(0)


@pytest.fixture(scope="module")
def network():
    with closing(Network()) as network:
        yield network


@pytest.fixture(scope="module")
def robot(network):
    context = multiprocessing.get_context("spawn")
    ready, done, heard = context.Event(), context.Event(), context.Queue()
    process = context.Process(target=other_side, args=(network.endpoint, messages(), ready, done, heard), daemon=True)
    process.start()
    assert ready.wait(60)
    yield heard
    done.set()
    process.join(10)
    process.kill()


def test_messages_of_another_implementation_arrive(network, robot):
    listener, got, sent = network.session(), {}, messages()
    for topic, message in sent.items():
        listener.subscribe(
            topic, lambda received: got.setdefault(received.topic, received), msgtype=message.__msgtype__
        )
    assert until(lambda: len(got) == len(sent), 10), got
    store = listener.types.store
    for topic, message in sent.items():
        assert got[topic].data == bytes(store.serialize_cdr(message, message.__msgtype__, little_endian=True))
        assert got[topic].sequence >= 0
        assert len(got[topic].publisher) == 16
    assert not listener.refused
    assert until(lambda: {t: m.__msgtype__ for t, m in sent.items()}.items() <= network.session().topics().items())


def test_another_implementation_receives_our_commands(network, robot):
    publish = network.session().publisher("/drive", ACKERMANN)
    drive = make("ackermann_msgs/AckermannDrive", steering_angle=0.25, steering_angle_velocity=0.0, speed=1.5,
                 acceleration=0.0, jerk=0.0)  # fmt: skip
    command = make(ACKERMANN.replace("/msg/", "/"), header=header(10**9, "base_link"), drive=drive)
    assert until(lambda: publish(command) or not robot.empty(), 10)
    assert robot.get(timeout=5) == (1.5, 0.25, "base_link")
