"""Sessions listen nowhere unless it is said; a router of its own outlives the process that started it."""

import json
import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from offpiste.core.errors import TransportError
from offpiste.logs.ros.writer import make
from offpiste.transport.zenoh_session import OUTLIVES, configuration
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport
from transport.routers import free_port, network, until
from transport.test_zenoh_transport import STRING, certificates, written
from transport.test_zenoh_transport import configuration as file_of

__all__ = ["network"]
HOSTS = """
import sys
from offpiste.transport.zenoh_transport import ZenohSettings
if __name__ == "__main__":
    with ZenohSettings(endpoint=sys.argv[1], mode="router").hosted():
        print("serves", flush=True)
        sys.stdin.read()
"""


def test_a_router_by_a_file_that_does_not_say_where_listens_on_the_loopback(tmp_path):
    config = configuration("", "router", written(tmp_path, "{ metadata: { name: 1 } }"))
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/127.0.0.1:7447"]
    assert config.get_json("scouting/multicast/enabled") == "false"


def test_what_a_file_says_holds_but_for_the_parts_of_a_drive(tmp_path):
    file = written(tmp_path, '{ mode: "peer", listen: { endpoints: ["tcp/127.0.0.1:1"] }, '
                             "scouting: { gossip: { enabled: true } } }")  # fmt: skip
    given = configuration("", "client", file)
    assert (given.get_json("mode"), given.get_json("listen/endpoints")) == ('"peer"', '["tcp/127.0.0.1:1"]')
    assert (given.get_json("scouting/gossip/enabled"), given.get_json("connect/endpoints")) == ("true", "[]")
    part = configuration("", "part", file)
    assert (part.get_json("mode"), part.get_json("listen/endpoints")) == ('"client"', "[]")


def serves(speaker, listener):
    got = []
    listener.subscribe("/a", got.append)
    publish = speaker.publisher("/a", STRING)
    return until(lambda: publish(make("std_msgs/String", data="x")) or got)


def test_a_router_outlives_the_process_that_started_it_and_then_ends(tmp_path):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    file = tmp_path / "hosts.py"
    file.write_text(HOSTS)
    parent = subprocess.Popen([sys.executable, str(file), endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert parent.stdout.readline() == b"serves\n"
    speaker = ZenohTransport(ZenohSettings(endpoint=endpoint))
    with closing(speaker), closing(ZenohTransport(ZenohSettings(endpoint=endpoint))) as listener:
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait()
        assert serves(speaker, listener), "a stop gets through"
        assert listener.routers() == 1
        assert until(lambda: listener.routers() == 0, OUTLIVES + 5.0)
    parent.communicate()


def test_a_router_ends_with_the_context():
    settings = ZenohSettings(endpoint=f"tcp/127.0.0.1:{free_port()}", mode="router")
    with settings.hosted() as given:
        assert (given.mode, given.endpoint, given.identity) == ("part", settings.endpoint, settings.identity)
        with closing(given.connect()) as speaker, closing(given.connect()) as listener:
            assert serves(speaker, listener)
    with pytest.raises(TransportError, match="no connection"):
        given.connect()


def test_where_another_is_the_router_it_is_one_line(network):
    settings = ZenohSettings(endpoint=network.endpoint, mode="router")
    with pytest.raises(TransportError, match="cannot be a router"), settings.hosted():
        pass


def test_parts_connect_to_the_router_of_a_file_with_their_side_of_its_certificates(tmp_path):
    certificates(tmp_path)
    port = free_port()
    sides = "".join(f'{side}_private_key: "{tmp_path}/{own}.key", {side}_certificate: "{tmp_path}/{own}.pem", '
                    for side, own in (("listen", "server"), ("connect", "client")))  # fmt: skip
    file = Path(file_of(tmp_path, port, "router", ""))
    file.write_text(file.read_text().replace("verify_name_on_connect", sides + "verify_name_on_connect"))
    with ZenohSettings(config=str(file), mode="router").hosted() as given:
        assert given.endpoint == f"tls/127.0.0.1:{port}"
        with closing(given.connect()) as speaker, closing(given.connect()) as listener:
            assert serves(speaker, listener)
