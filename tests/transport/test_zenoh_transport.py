"""Sessions over a router on the loopback: what is carried, and what is refused and counted."""

import itertools
import os
import subprocess
import sys
from pathlib import Path

import pytest

from offpiste.core.errors import TransportError
from offpiste.logs.ros.writer import make
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport
from transport.routers import Network, free_port, network, until

__all__ = ["network"]
STRING = "std_msgs/msg/String"
SHARED = Path("/dev/shm")


def text(data):
    return make("std_msgs/String", data=data)


@pytest.mark.parametrize("keys", ["rmw_zenoh", "bridge"])
def test_messages_arrive_in_order_with_their_numbers(keys):
    network, got = Network(keys=keys), []
    try:
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
    finally:
        network.close()


def test_types_of_the_bridge_are_those_that_it_announces():
    network, got = Network(keys="bridge"), []
    try:
        token = "@/1f/@ros2_lv/MP/a§b/std_msgs§msg§String/::,10:"
        bridge = network.router._session.liveliness().declare_token(token)
        listener = network.session()
        assert until(lambda: listener.topics() == {"/a/b": STRING})
        listener.subscribe("/a/b", got.append)
        listener.subscribe("/c", got.append)
        data = b"\x00\x01\x00\x00\x02\x00\x00\x00h\x00"
        assert until(lambda: network.router._session.put("a/b", data) or got), "sent as the bridge does: no attachment"
        assert (got[0].type, got[0].sequence, got[0].publisher) == (STRING, -1, b"")
        assert until(lambda: network.router._session.put("c", data) or listener.refused)
        assert list(listener.refused) == ["/c: unknown type (unknown)"]
        assert bridge is not None
    finally:
        network.close()


def test_who_comes_later_is_sent_what_is_kept(network):
    network.session().publisher("/tf_static", STRING, keep=True)(text("kept"))
    late, got = network.session(), []
    late.subscribe("/tf_static", got.append, history=True)
    assert until(lambda: got)
    assert late.decode(got[0]).data == "kept"
    assert until(lambda: late.topics() == {"/tf_static": STRING})


def test_what_does_not_fit_is_refused_and_counted(network):
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


def test_a_router_that_comes_back_is_found_again():
    network, got = Network(), []
    try:
        client = network.session()
        client.subscribe("/a", got.append)
        network.router.close()
        assert until(lambda: client.routers() == 0)
        network.router = network.session(mode="router")
        publish = network.router.publisher("/a", STRING)
        assert until(lambda: publish(text("x")) or got, 10.0)
        assert client.routers() == 1
    finally:
        network.close()


def test_without_a_router_it_ends_in_one_line_soon():
    with pytest.raises(TransportError, match=r"no connection.*rmw_zenohd"):
        ZenohTransport(ZenohSettings(endpoint=f"tcp/127.0.0.1:{free_port()}"))


def test_two_routers_do_not_share_a_port(network):
    with pytest.raises(TransportError, match="cannot be a router"):
        network.session(mode="router")


def sockets():
    """Local addresses of this process's sockets that listen, and of those of UDP."""
    listening = subprocess.run(["ss", "-Hltunp"], capture_output=True, text=True, check=False).stdout
    if not listening:
        pytest.skip("no `ss` here")
    return [line.split()[4] for line in listening.splitlines() if f"pid={os.getpid()}," in line]


def test_nothing_listens_on_another_address_than_the_loopback(network):
    network.session()
    ours = sockets()
    assert ours, "the router's"
    assert all(address.startswith("127.0.0.1:") for address in ours)


def written(folder, text):
    file = folder / "zenoh.json5"
    file.write_text(text)
    return str(file)


@pytest.mark.parametrize("mode", ["client", "part"])
def test_what_a_file_does_not_say_is_as_without_one(network, tmp_path, mode):
    before, got = sockets(), []
    file = written(tmp_path, f'{{ connect: {{ endpoints: ["{network.endpoint}"] }} }}')
    session = network.session(config=file, endpoint="", mode=mode)
    assert sockets() == before, "it listens nowhere, and looks for nobody"
    session.subscribe("/a", got.append)
    publish = network.router.publisher("/a", STRING)
    assert until(lambda: publish(text("x")) or got)


def certificates(folder):
    """An authority, and what it signed for a server and a client on the loopback."""

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


def configuration(folder, port, mode, own):
    """File of zenoh's configuration with certificates of both sides."""
    side = "listen" if mode == "router" else "connect"
    where = "listen" if mode == "router" else "connect"
    keys = f'{side}_private_key: "{folder}/{own}.key", {side}_certificate: "{folder}/{own}.pem",' if own else ""
    file = folder / f"{mode}-{own}.json5"
    file.write_text(f"""{{
      mode: "{mode}", {where}: {{ endpoints: ["tls/127.0.0.1:{port}"], timeout_ms: 2000 }},
      scouting: {{ multicast: {{ enabled: false }} }},
      transport: {{ link: {{ tls: {{ enable_mtls: true, verify_name_on_connect: false, {keys}
        root_ca_certificate: "{folder}/ca.pem" }} }} }},
    }}""")
    return str(file)


def test_tls_with_certificates_of_both_sides(tmp_path):
    certificates(tmp_path)
    port, got = free_port(), []
    router = ZenohTransport(ZenohSettings(config=configuration(tmp_path, port, "router", "server"), mode="router"))
    try:
        known = ZenohTransport(ZenohSettings(config=configuration(tmp_path, port, "client", "client")))
        router.subscribe("/a", got.append)
        publish = known.publisher("/a", STRING)
        assert until(lambda: publish(text("x")) or got)
        known.close()
        with pytest.raises(TransportError, match="no connection"):
            ZenohTransport(ZenohSettings(config=configuration(tmp_path, port, "client", "")))
    finally:
        router.close()


@pytest.mark.skipif(not SHARED.is_dir(), reason="no /dev/shm here")
def test_a_killed_session_leaves_no_shared_memory(network):
    code = f"""
import os
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport
transport = ZenohTransport(ZenohSettings(endpoint="{network.endpoint}"))
os.kill(os.getpid(), 9)
"""
    before = set(SHARED.glob("*.zenoh"))
    done = subprocess.run([sys.executable, "-c", code], check=False)
    assert done.returncode == -9
    assert set(SHARED.glob("*.zenoh")) <= before
