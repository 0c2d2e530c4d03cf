"""Zenoh sessions over a router on the loopback: messages, refusals, configuration, and the router's process."""

import itertools
import json
import os
import signal
import subprocess
import sys
from contextlib import closing

import pytest

from offpiste.core.errors import TransportError
from offpiste.logs.ros.writer import make
from offpiste.transport.zenoh_session import OUTLIVES, configuration
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport
from transport.routers import Network, free_port, until

STRING = "std_msgs/msg/String"
HOSTS = """
import sys
from offpiste.transport.zenoh_transport import ZenohSettings
if __name__ == "__main__":
    with ZenohSettings(endpoint=sys.argv[1], mode="router").hosted():
        print("serves", flush=True)
        sys.stdin.read()
"""


@pytest.fixture
def bridge():
    """A network with the keys of the bridge."""
    with closing(Network(keys="bridge")) as bridge:
        yield bridge


def serves(speaker, listener):
    """Whether messages pass from one session to another."""
    got = []
    listener.subscribe("/a", got.append)
    publish = speaker.publisher("/a", STRING)
    return until(lambda: publish(text("x")) or got, 10.0)


def text(data):
    return make("std_msgs/String", data=data)


@pytest.mark.parametrize("keys", ["network", "bridge"])
def test_messages_arrive_in_order_with_their_numbers(request, keys):
    network, got = request.getfixturevalue(keys), []
    listener, speaker = network.session(), network.session(patient=True)
    listener.subscribe("/a/b", got.append, msgtype=STRING)
    publish = speaker.publisher("/a/b", STRING)
    assert until(lambda: publish(text("x")) or got)
    for k in range(50):
        publish(text(str(k)))
    assert until(lambda: listener.decode(got[-1]).data == "49")
    del got[:-50]
    assert [listener.decode(message).data for message in got] == [str(k) for k in range(50)]
    assert [b.sequence - a.sequence for a, b in itertools.pairwise(got)] == [1] * 49
    assert {message.publisher[:8] for message in got} == {speaker.identity}
    assert not listener.refused


def test_types_of_the_bridge_are_those_of_its_tokens(bridge):
    session, listener, got = bridge.router._session, bridge.session(), []
    token = session.liveliness().declare_token("@/1f/@ros2_lv/MP/a§b/std_msgs§msg§String/::,10:")
    assert until(lambda: listener.topics() == {"/a/b": STRING})
    listener.subscribe("/a/b", got.append)
    listener.subscribe("/c", got.append)
    data = b"\x00\x01\x00\x00\x02\x00\x00\x00h\x00"
    assert until(lambda: session.put("a/b", data) or got), "without an attachment, like the bridge"
    assert (got[0].type, got[0].sequence, got[0].publisher) == (STRING, -1, b"")
    assert until(lambda: session.put("c", data) or listener.refused)
    assert list(listener.refused) == ["/c: unknown type (unknown)"]
    assert token is not None


def test_later_subscribers_are_sent_the_last_message(network):
    network.session().publisher("/tf_static", STRING, keep=True)(text("kept"))
    late, got = network.session(), []
    late.subscribe("/tf_static", got.append, history=True)
    assert until(lambda: got)
    assert late.decode(got[0]).data == "kept"
    assert until(lambda: late.topics() == {"/tf_static": STRING})


def test_invalid_messages_are_refused_and_counted(network):
    listener, speaker, got = network.session(largest=0.01), network.session(), []
    listener.subscribe("/a", got.append, msgtype=STRING)
    listener.subscribe("/any", got.append)
    listener.subscribe("/c", got.append)
    session = speaker._session
    number = speaker.publisher("/a", "std_msgs/msg/Float64")
    large = speaker.publisher("/c", STRING)
    hashed = speaker.types.hash_of(STRING)
    assert until(lambda: number(make("std_msgs/Float64", data=1.0)) or listener.refused)
    large(text("x" * 20_000))
    session.put(f"0/a/std_msgs::msg::dds_::String_/{hashed[:-1]}x", b"")
    session.put("0/any/evil_msgs::msg::dds_::Thing_/RIHS01_0", b"")
    session.put("0/c/std_msgs::msg::dds_::String_/" + hashed, b"\x00\x01\x00\x00\xff\xff\xff\xff")
    session.delete("0/c/std_msgs::msg::dds_::String_/" + hashed)
    session.put("0/c/std_msgs::msg::dds_::String_/TypeHashNotSupported", b"\x00\x01\x00\x00\x02\x00\x00\x00h\x00")
    assert until(lambda: len(got) == 2), "the one that cannot be decoded, and Humble's without a hash"
    assert listener.decode(got[0]) is None
    assert listener.decode(got[1]).data == "h"
    refused = dict(listener.refused)
    assert refused.pop("/a: of type std_msgs/msg/Float64") >= 1
    assert refused == {
        "/c: too large": 1,
        "/a: another definition of its type (its hash differs)": 1,
        "/any: unknown type evil_msgs/msg/Thing": 1,
        "/c: cannot be decoded": 1,
    }


def test_a_router_that_comes_back_is_found_by_publishers_and_subscribers(network):
    speaker, listener, got = network.session(), network.session(), []
    listener.subscribe("/a", got.append)
    publish = speaker.publisher("/a", STRING)
    network.router.close()
    assert until(lambda: speaker.routers() == listener.routers() == 0)
    network.router = network.session(mode="router")
    assert until(lambda: publish(text("x")) or got, 10.0)
    assert speaker.routers() == listener.routers() == 1


def test_a_missing_router_and_a_second_one_are_refused(network):
    with pytest.raises(TransportError, match=r"no connection.*rmw_zenohd"):
        ZenohTransport(ZenohSettings(endpoint=f"tcp/127.0.0.1:{free_port()}"))
    with pytest.raises(TransportError, match="cannot be a router"):
        network.session(mode="router")
    with pytest.raises(TransportError, match="cannot be a router"):
        ZenohSettings(endpoint=network.endpoint, mode="router").hosted().__enter__()


def sockets():
    """Return local addresses of this process's listening and UDP sockets."""
    listening = subprocess.run(["ss", "-Hltunp"], capture_output=True, text=True, check=False).stdout
    if not listening:
        pytest.skip("no `ss` here")
    return [line.split()[4] for line in listening.splitlines() if f"pid={os.getpid()}," in line]


def test_only_the_loopback_is_listened_on(network):
    network.session()
    ours = sockets()
    assert ours, "the router's"
    assert all(address.startswith("127.0.0.1:") for address in ours)


def written(folder, text):
    file = folder / "zenoh.json5"
    file.write_text(text)
    return str(file)


@pytest.mark.parametrize("mode", ["client", "part"])
def test_with_a_partial_file_a_session_neither_listens_nor_scouts(network, tmp_path, mode):
    before = sockets()
    file = written(tmp_path, f'{{ connect: {{ endpoints: ["{network.endpoint}"] }} }}')
    session = network.session(config=file, endpoint="", mode=mode)
    assert sockets() == before
    assert serves(network.router, session)


def test_a_file_overrides_defaults_except_for_parts(tmp_path):
    config = configuration("", "router", written(tmp_path, "{ metadata: { name: 1 } }"))
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/127.0.0.1:7447"]
    assert config.get_json("scouting/multicast/enabled") == "false"
    file = written(tmp_path, '{ mode: "peer", listen: { endpoints: ["tcp/127.0.0.1:1"] }, '
                             "scouting: { gossip: { enabled: true } } }")  # fmt: skip
    given = configuration("", "client", file)
    assert (given.get_json("mode"), given.get_json("listen/endpoints")) == ('"peer"', '["tcp/127.0.0.1:1"]')
    assert (given.get_json("scouting/gossip/enabled"), given.get_json("connect/endpoints")) == ("true", "[]")
    part = configuration("", "part", file)
    assert (part.get_json("mode"), part.get_json("listen/endpoints")) == ('"client"', "[]")


def certificates(folder):
    """Create an authority, and certificates of a server and a client on the loopback."""

    def run(*arguments):
        subprocess.run(["openssl", *arguments], check=True, capture_output=True, cwd=folder)

    run("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout", "ca.key",
        "-out", "ca.pem", "-days", "2", "-subj", "/CN=test authority")  # fmt: skip
    (folder / "san").write_text("subjectAltName=IP:127.0.0.1,DNS:localhost\n")
    for name in ("server", "client"):
        run("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout", f"{name}.key",
            "-out", f"{name}.csr", "-subj", f"/CN={name}")  # fmt: skip
        run("x509", "-req", "-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial",
            "-out", f"{name}.pem", "-days", "2", "-extfile", "san")  # fmt: skip


def test_tls_with_certificates_of_both_sides(tmp_path):
    certificates(tmp_path)
    port = free_port()

    def tls(name, *sides):
        keys = "".join(f'{side}_private_key: "{tmp_path}/{own}.key", {side}_certificate: "{tmp_path}/{own}.pem", '
                       for side, own in sides)  # fmt: skip
        file, where = tmp_path / f"{name}.json5", "listen" if name == "router" else "connect"
        file.write_text(f"""{{
          mode: "{name}", {where}: {{ endpoints: ["tls/127.0.0.1:{port}"], timeout_ms: 2000 }},
          scouting: {{ multicast: {{ enabled: false }} }},
          transport: {{ link: {{ tls: {{ enable_mtls: true, {keys} verify_name_on_connect: false,
            root_ca_certificate: "{tmp_path}/ca.pem" }} }} }},
        }}""")
        return str(file)

    settings = ZenohSettings(config=tls("router", ("listen", "server"), ("connect", "client")), mode="router")
    with settings.hosted() as given:
        assert given.endpoint == f"tls/127.0.0.1:{port}"
        with closing(ZenohTransport(given)) as speaker, closing(ZenohTransport(given)) as listener:
            assert serves(speaker, listener)
        with pytest.raises(TransportError, match="no connection"):
            ZenohTransport(ZenohSettings(config=tls("client")))


def test_a_router_ends_with_the_context():
    settings = ZenohSettings(endpoint=f"tcp/127.0.0.1:{free_port()}", mode="router")
    with settings.hosted() as given:
        assert (given.mode, given.endpoint, given.identity) == ("part", settings.endpoint, settings.identity)
        with closing(ZenohTransport(given)) as speaker, closing(ZenohTransport(given)) as listener:
            assert serves(speaker, listener)
    with pytest.raises(TransportError, match="no connection"):
        ZenohTransport(given)


def test_a_router_outlives_its_parent_and_then_ends(tmp_path):
    endpoint, file = f"tcp/127.0.0.1:{free_port()}", tmp_path / "hosts.py"
    file.write_text(HOSTS)
    parent = subprocess.Popen([sys.executable, str(file), endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert parent.stdout.readline() == b"serves\n"
    speaker = ZenohTransport(ZenohSettings(endpoint=endpoint))
    with closing(speaker), closing(ZenohTransport(ZenohSettings(endpoint=endpoint))) as listener:
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait()
        assert serves(speaker, listener), "a stop gets through"
        assert until(lambda: listener.routers() == 0, OUTLIVES + 5.0)
    parent.communicate()
