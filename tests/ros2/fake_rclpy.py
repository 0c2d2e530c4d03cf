"""Substitute for rclpy: nodes of one process, with the signatures of ROS 2 Jazzy that the example uses."""

import enum
import sys
import threading
import time
from types import ModuleType, SimpleNamespace


class ReliabilityPolicy(enum.Enum):
    RELIABLE = 1
    BEST_EFFORT = 2
    BEST_AVAILABLE = 5


class DurabilityPolicy(enum.Enum):
    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    BEST_AVAILABLE = 5


class QoSProfile:
    def __init__(self, *, depth, durability=DurabilityPolicy.VOLATILE, reliability=ReliabilityPolicy.RELIABLE):
        self.depth, self.durability, self.reliability = depth, durability, reliability

    def hears(self, publisher):
        """Return whether a subscription with this quality is compatible with a publisher's."""
        keeps = publisher.durability == DurabilityPolicy.TRANSIENT_LOCAL
        reliable = publisher.reliability == ReliabilityPolicy.RELIABLE
        asks = self.durability == DurabilityPolicy.TRANSIENT_LOCAL, self.reliability == ReliabilityPolicy.RELIABLE
        return (keeps or not asks[0]) and (reliable or not asks[1])


class Publisher:
    def __init__(self, node, kind, topic, quality):
        self.node, self.kind, self.topic, self.quality, self.kept = node, kind, topic, quality, []

    def publish(self, msg):
        assert isinstance(msg, bytes), "messages are serialised by offpiste"
        if self.quality.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            self.kept = [msg]
        for subscription in self.node.graph.subscriptions:
            if subscription.topic == self.topic and subscription.quality.hears(self.quality):
                subscription.callback(msg)


class Node:
    def __init__(self, graph, name):
        self.graph, self.name, self.timers, self.destroyed = graph, name, [], False
        graph.nodes.append(self)

    def create_publisher(self, msg_type, topic, qos_profile):
        publisher = Publisher(self, msg_type.NAME, topic, qos_profile)
        self.graph.publishers.append(publisher)
        return publisher

    def create_subscription(self, msg_type, topic, callback, qos_profile, *, raw=False):
        assert raw, "messages are decoded by offpiste"
        subscription = SimpleNamespace(kind=msg_type.NAME, topic=topic, callback=callback, quality=qos_profile)
        self.graph.subscriptions.append(subscription)
        if qos_profile.durability == DurabilityPolicy.BEST_AVAILABLE:
            for kept in (kept for p in self.graph.publishers if p.topic == topic for kept in p.kept):
                callback(kept)
        return subscription

    def create_timer(self, timer_period_sec, callback):
        self.timers.append((timer_period_sec, callback))

    def get_topic_names_and_types(self):
        return [(publisher.topic, [publisher.kind]) for publisher in self.graph.publishers]

    def get_publishers_info_by_topic(self, topic_name):
        found = [publisher for publisher in self.graph.publishers if publisher.topic == topic_name]
        return [SimpleNamespace(node_name=publisher.node.name) for publisher in found]

    def destroy_node(self):
        self.destroyed = True


class SingleThreadedExecutor:
    def __init__(self, *, context):
        self._nodes, self._ended = [], threading.Event()

    def add_node(self, node):
        self._nodes.append(node)

    def spin(self):
        while not self._ended.is_set():
            for node in self._nodes:
                for _, callback in node.timers:
                    callback()
            time.sleep(0.01)  # sooner than the periods: tests need not wait

    def shutdown(self):
        self._ended.set()


class Context:
    initialised = False

    def try_shutdown(self):
        self.initialised = False


class Graph:
    """State shared by all nodes, and the modules that replace rclpy's."""

    def __init__(self):
        self.nodes, self.publishers, self.subscriptions, self.signals = [], [], [], []

    def install(self, monkeypatch):
        def init(*, args, context, signal_handler_options):
            context.initialised = True
            self.signals.append(signal_handler_options)

        def create_node(node_name, *, context):
            assert context.initialised
            return Node(self, node_name)

        def get_message(identifier):
            package, _, name = identifier.split("/")
            if package == "unbuilt_msgs":
                raise ModuleNotFoundError(package)
            return type(name, (), {"NAME": identifier})

        modules = {
            "rclpy": {"Context": Context, "init": init, "create_node": create_node},
            "rclpy.executors": {"SingleThreadedExecutor": SingleThreadedExecutor},
            "rclpy.signals": {"SignalHandlerOptions": enum.Enum("SignalHandlerOptions", "NO ALL")},
            "rclpy.qos": {
                "DurabilityPolicy": DurabilityPolicy,
                "QoSProfile": QoSProfile,
                "ReliabilityPolicy": ReliabilityPolicy,
            },
            "rclpy.utilities": {"remove_ros_args": without_ros_args},
            "rosidl_runtime_py": {},
            "rosidl_runtime_py.utilities": {"get_message": get_message},
        }
        for name, held in modules.items():
            module = ModuleType(name)
            module.__dict__.update(held, __path__=[])
            module.__spec__ = SimpleNamespace(name=name)
            monkeypatch.setitem(sys.modules, name, module)
        return self


def without_ros_args(args):
    """Arguments up to `--ros-args`."""
    return args[: args.index("--ros-args")] if "--ros-args" in args else list(args)
