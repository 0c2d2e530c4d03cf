"""An S3 server for tests, on this machine."""

from collections.abc import Iterator
from contextlib import contextmanager
from unittest import mock

import boto3
import s3fs
from moto.server import ThreadedMotoServer


@contextmanager
def s3_server(bucket: str) -> Iterator[None]:
    """A server with an empty bucket; the environment of this process and its children leads to it."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    environment = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    try:
        with mock.patch.dict("os.environ", environment):
            s3fs.S3FileSystem.clear_instance_cache()  # of file systems that lead elsewhere
            boto3.client("s3").create_bucket(Bucket=bucket)
            yield
    finally:
        s3fs.S3FileSystem.clear_instance_cache()
        server.stop()
