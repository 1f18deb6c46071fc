"""A client of `crazyflie serve` in Python: requests with growing ids, resumed over a new connection if one is lost."""

from __future__ import annotations

import json
import struct
import time
from typing import Any

from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

REPLY = struct.Struct("<QBBHIIIQ")
"""The header of a binary reply; its first number is the id."""

_MOST_BYTES = 256 << 20
_CONNECT_TIMEOUT_S = 10.0
_CLOSE_TIMEOUT_S = 1.0
_PAUSES_S = (0.05, 1.0)
# close code of a server that got no answers to its pings; the session waits
_SILENT = 4002
# codes that blame the arguments, as opposed to the moment; python_client/src/remote/client_error.rs has the same list
_ARGUMENT = {
    "bad_message",
    "bad_frame",
    "wrong_length",
    "bad_action",
    "bad_options",
    "bad_model",
    "too_large",
    "unknown_scenario",
    "bad_token",
    "bad_name",
    "bad_shape",
    "unknown_world",
    "unknown_drone",
}


class LostError(ConnectionError):
    """The connection is gone; the session may be waiting."""


class Client:
    """A connection, and the session to resume over another one."""

    def __init__(self, url: str, token: str | None) -> None:
        self.resume_s = 0.0
        self.resumed = 0
        # name and token of a session to come back to
        self.session: tuple[str, str] | None = None
        self._url = url
        self._id = 0
        self._hello = {"client": "crazyflie_gym (Python)"} | ({} if token is None else {"token": token})
        self._welcome: dict[str, Any] = {"idle_s": 60.0, "max_text_bytes": 1 << 16}
        self._ws = self._connect()
        self._welcome = json.loads(self.ask("hello", json.dumps(self._hello)))
        self.resume_s = self._welcome["resume_s"]

    def next_id(self) -> int:
        """Return the id of the next request; its repetition has the same, so that it is carried out once."""
        self._id += 1
        return self._id

    def close(self) -> None:
        """Say goodbye; the server ends the session."""
        self.session = None
        self._ws.close()

    def _connect(self) -> ClientConnection:
        try:
            # entered and never left: it is closed by hand, like the environment that has it
            return connect(
                self._url,
                subprotocols=[Subprotocol("crazyflie.v1")],
                compression=None,
                max_size=_MOST_BYTES,
                open_timeout=_CONNECT_TIMEOUT_S,
                close_timeout=_CLOSE_TIMEOUT_S,
                proxy=None,
            ).__enter__()
        except (OSError, InvalidHandshake, EOFError) as error:
            raise LostError(f"the connection to {self._url} was lost: {error}") from None

    def ask(self, kind: str, fields: str = "{}") -> str:
        """Send a request in JSON and return its reply, JSON."""
        number = self.next_id()
        text = json.dumps({**json.loads(fields), "id": number, "type": kind})
        most = self._welcome["max_text_bytes"]
        if len(text.encode()) > most:
            raise ValueError(f"{kind}: a message of {len(text.encode())} bytes, the server takes {most}")
        reply = self.exchange(number, text)
        if not isinstance(reply, str):
            raise self.unexpected(f"a binary reply to {kind}")
        return reply

    def exchange(self, number: int, request: str | bytes) -> str | bytes:
        """Send a request and return its reply; over a new connection if that is what it takes."""
        try:
            return self._try_once(number, request)
        except LostError as lost:
            self._resume(lost)
        return self._try_once(number, request)

    def _try_once(self, number: int, request: str | bytes) -> str | bytes:
        try:
            self._ws.send(request)
            while True:
                reply = self._ws.recv(timeout=self._welcome["idle_s"])
                got, refused = self._id_and_error(reply)
                if got in (number, None):
                    if refused is not None:
                        raise refused
                    return reply
                # a smaller one is of a request whose caller was interrupted
                if got > number:
                    raise self.unexpected(f"a reply with the id {got}, expected {number}")
        except ConnectionClosed as closed:
            raise self._close_error(closed) from None
        except TimeoutError:
            raise LostError(f"the connection to {self._url} was lost: no reply in time") from None

    def _id_and_error(self, reply: str | bytes) -> tuple[Any, Exception | None]:
        """Return the id of a reply, and the error that it may be."""
        if isinstance(reply, bytes):
            if len(reply) < REPLY.size:
                raise self.unexpected(f"a message of {len(reply)} bytes")
            return REPLY.unpack_from(reply)[0], None
        message = json.loads(reply)
        if message["type"] != "error":
            return message["id"], None
        kind = ValueError if message["code"] in _ARGUMENT else RuntimeError
        return message["id"], kind(message["message"])

    def _close_error(self, closed: ConnectionClosed) -> ConnectionError:
        frame = closed.rcvd
        if frame is None:
            return LostError(f"the connection to {self._url} was lost: {closed}")
        why = f"{frame.reason} (close code {int(frame.code)})"
        if frame.code in (1005, _SILENT):
            return LostError(f"the connection to {self._url} was lost: {why}")
        return ConnectionError(f"the connection to {self._url} has ended: {why}")

    def unexpected(self, why: str) -> ConnectionError:
        """Return the error of a reply that makes no sense."""
        return ConnectionError(f"{self._url} answers in a way that the protocol does not know: {why}")

    def _resume(self, lost: LostError) -> None:
        """Connect anew and take the session up again."""
        began, pause_s = time.monotonic(), _PAUSES_S[0]
        if self.session is None:
            raise lost
        name, token = self.session
        while True:
            try:
                self._ws = self._connect()
                # these two are the connection's, not the session's: their ids need not grow
                self._try_once(0, json.dumps({**self._hello, "id": 0, "type": "hello"}))
                self._try_once(0, json.dumps({"id": 0, "type": "resume", "session": name, "token": token}))
            except LostError:
                if time.monotonic() - began >= self.resume_s:
                    raise lost from None
            except (ValueError, RuntimeError) as refused:
                raise ConnectionError(f"the connection to {self._url} has ended: {lost}; {refused}") from None
            else:
                self.resumed += 1
                return
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, _PAUSES_S[1])
