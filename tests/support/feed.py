"""A broker, certificates and a consumer of the alert feed, to test calib-uplink with."""

import base64
import contextlib
import ctypes
import ctypes.util
import hashlib
import json
import pathlib
import shutil
import signal
import socket
import ssl
import subprocess
import threading
import time

import paho.mqtt.client as mqtt
import pytest

MOSQUITTO = shutil.which("mosquitto") or shutil.which("/usr/sbin/mosquitto")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for(condition, what, seconds=30):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"not within {seconds} s: {what}"
        time.sleep(0.02)


class Authority:
    """A certificate authority of one test run, and what it signs."""

    def __init__(self, folder, name):
        self.folder = pathlib.Path(folder) / name
        self.folder.mkdir()
        self.certificate = self.folder / "ca.pem"
        self._openssl("req", "-x509", "-newkey", "ed25519", "-nodes", "-keyout", self.folder / "ca.key", "-out",
                      self.certificate, "-days", "2", "-subj", f"/CN=test {name}")

    def _openssl(self, *arguments):
        subprocess.run(["openssl", *map(str, arguments)], check=True, capture_output=True, cwd=self.folder)

    def sign(self, name, expired=False):
        """Certificate and key of a host or a client."""
        request, certificate, key = (self.folder / f"{name}.{ending}" for ending in ("csr", "pem", "key"))
        self._openssl("req", "-newkey", "ed25519", "-nodes", "-keyout", key, "-out", request, "-subj", f"/CN={name}",
                      "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1")
        (self.folder / "index.txt").touch()
        (self.folder / "ca.conf").write_text(
            "[ca]\ndefault_ca=own\n[own]\ndatabase=index.txt\nnew_certs_dir=.\nrand_serial=yes\ndefault_md=default\n"
            "policy=any\ncopy_extensions=copy\nunique_subject=no\n[any]\ncommonName=supplied\n")
        end = "20200102000000Z" if expired else "20991231000000Z"
        self._openssl("ca", "-config", "ca.conf", "-batch", "-notext", "-cert", self.certificate, "-keyfile",
                      self.folder / "ca.key", "-startdate", "20200101000000Z", "-enddate", end, "-in", request, "-out",
                      certificate)
        return certificate, key


class Broker:
    """A mosquitto that wants TLS 1.3 and certificates, and keeps what it has acknowledged."""

    def __init__(self, folder, authority, certificate=None):
        self.port = free_port()
        self.running = None
        folder = pathlib.Path(folder)
        self.log = folder / "broker.log"
        self.configuration = folder / "mosquitto.conf"
        self.rights = folder / "acl"
        self.allow("#")
        chain, key = certificate or authority.sign("localhost")
        self.configuration.write_text(
            f"user root\npersistence true\npersistence_location {folder}/\nautosave_interval 1\n"
            f"autosave_on_changes true\nlog_dest stderr\nlistener {self.port} 127.0.0.1\ncafile {authority.certificate}\n"
            f"certfile {chain}\nkeyfile {key}\nrequire_certificate true\nuse_identity_as_username true\n"
            f"tls_version tlsv1.3\nmax_queued_messages 0\nacl_file {self.rights}\n")

    def allow(self, topic):
        """To each vehicle, below its own topics; as of the next start."""
        self.rights.write_text(f"user consumer\ntopic read fleet/v1/#\npattern write fleet/v1/%u/calib/{topic}\n")
        self.rights.chmod(0o600)

    def start(self):
        with open(self.log, "ab") as log:
            self.running = subprocess.Popen([MOSQUITTO, "-c", self.configuration], stdout=log, stderr=log)
        wait_for(self.listens, "the broker listens")

    def listens(self):
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def stop(self, how=signal.SIGTERM):
        if self.running:
            self.running.send_signal(how)
            self.running.wait()
        self.running = None


class Consumer:
    """Everything that a broker delivers, over all connections, in the order of arrival."""

    def __init__(self, broker, authority):
        self.messages = []  # (topic, text, retained, time of arrival)
        self.subscribed = threading.Event()
        certificate, key = authority.sign("consumer")
        self.client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, "consumer", protocol=mqtt.MQTTv5)
        self.client.tls_set(str(authority.certificate), str(certificate), str(key), tls_version=ssl.PROTOCOL_TLS_CLIENT)
        self.client.reconnect_delay_set(1, 1)
        self.client.on_connect = lambda client, *_: client.subscribe("fleet/v1/+/calib/#", qos=1)
        self.client.on_subscribe = lambda *_: self.subscribed.set()
        self.client.on_message = lambda client, data, message: self.messages.append(
            (message.topic, message.payload.decode(), message.retain, time.time()))
        properties = mqtt.Properties(mqtt.PacketTypes.CONNECT)
        properties.SessionExpiryInterval = 3600
        self.client.connect("localhost", broker.port, clean_start=False, properties=properties)
        self.client.loop_start()
        assert self.subscribed.wait(10)

    def close(self):
        self.client.disconnect()
        self.client.loop_stop()

    def of(self, name):
        return [message for message in list(self.messages) if message[0].endswith("/calib/" + name)]


class OldBroker:
    """Speaks MQTT 3.1.1 and nothing newer, to one client at a time, without TLS."""

    def __init__(self, refuses_with_a_word):
        self.refuses_with_a_word, self.published, self.levels = refuses_with_a_word, [], []
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        while True:
            connection, _ = self.socket.accept()
            with connection, connection.makefile("rb") as stream, contextlib.suppress(OSError, IndexError):
                self._talk(connection, stream)

    def _talk(self, connection, stream):
        while True:
            kind, length, shift = stream.read(1)[0], 0, 0
            while True:
                byte = stream.read(1)[0]
                length |= (byte & 0x7F) << shift
                shift += 7
                if byte < 0x80:
                    break
            body = stream.read(length)
            if kind == 0x10:
                self.levels.append(body[6])
                if body[6] != 4:
                    connection.sendall(b"\x20\x02\x00\x01" if self.refuses_with_a_word else b"")
                    return
                connection.sendall(b"\x20\x02\x00\x00")
            elif kind >> 4 == 3:
                name = 2 + int.from_bytes(body[:2], "big")
                self.published.append((body[2:name].decode(), body[name + 2:].decode()))
                connection.sendall(b"\x40\x02" + body[name:name + 2])


def ask(path, request, **fields):
    """One request to calibd, and its answer."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(60)
        connection.connect(str(path))
        connection.sendall(json.dumps({"schema": 1, "request": request, **fields}).encode() + b"\n")
        return json.loads(connection.makefile("rb").readline())


def is_signed(event, public_key_file):
    """As proto/feed.md says it is checked, with libsodium alone."""
    raw = base64.b64decode(pathlib.Path(public_key_file).read_text().splitlines()[1])
    event = dict(event)
    signature = base64.b64decode(event.pop("signature"))
    signed = json.dumps(event, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
    digest = hashlib.blake2b(signed).digest()
    sodium = ctypes.CDLL(ctypes.util.find_library("sodium") or "libsodium.so.23")
    return signature[:2] == b"ED" and signature[2:10] == raw[2:10] and sodium.crypto_sign_verify_detached(
        signature[10:], digest, ctypes.c_ulonglong(len(digest)), raw[10:]) == 0


def schema_validator(source_dir):
    """Validates an event against proto/feed.schema.json."""
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((pathlib.Path(source_dir) / "proto" / "feed.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema).validate


def check_feed(texts, public_key_file, validate):
    """What a consumer checks: signatures, no loss, the same id for the same event only, and the order. Returns the
    number of duplicates."""
    known, last = {}, 0
    for text in texts:
        event = json.loads(text)
        assert len(text.encode()) <= 2000
        assert known.get(event["id"], text) == text, "two events have the same id"
        if event["id"] in known:
            continue
        known[event["id"]] = text
        validate(event)
        assert is_signed(event, public_key_file), text
        assert event["id"] == f"{event['data']['vehicle']}-{event['data']['sequence']}"
        assert event["data"]["previous"] == last, f"between {last} and {event['data']['sequence']} events are missing"
        last = event["data"]["sequence"]
    return len(texts) - len(known)


@pytest.fixture(scope="session")
def authority(tmp_path_factory):
    if not MOSQUITTO:
        pytest.skip("mosquitto is not installed")
    return Authority(tmp_path_factory.mktemp("pki"), "authority")
