"""The way from the broker to Celery: rings pass, junk is dropped as it is read.

Celery 5.7 ends the whole worker over one message that is not JSON, and starts the connection anew
over one without an envelope. The supervisor would start the worker again within seconds, for each
piece of junk. Here it is taken out of the queue, named in the log, and nothing else happens. What a
queue loses is never lost: the records are the queue.

Only documented points of extension: `Celery(amqp=...)`, `AMQP.Connection`, `Transport.Channel`, and
the client of a channel, which is redis-py's `Redis`.
"""

from functools import partial
from typing import Any

import structlog
from celery.app.amqp import AMQP
from kombu import Connection
from kombu.transport import redis as kombu_redis
from kombu.transport.base import Transport

from exceptiondrive_worker.rings import why_no_ring

_log = structlog.get_logger("exceptiondrive.worker")


class _RingClient(kombu_redis.PrefixedStrictRedis):
    """Reads what the broker sends; an answer that holds junk is as one that holds nothing."""

    def parse_response(self, connection: Any, command_name: str, **options: Any) -> Any:
        answer = super().parse_response(connection, command_name, **options)
        if command_name != "BRPOP" or not answer:
            return answer
        queue, message = answer
        reason = why_no_ring(message)
        if reason is None:
            return answer
        _log.warning(
            "junk dropped from a queue",
            queue=queue.decode(errors="replace"),
            size_bytes=len(message),
            reason=reason,
        )
        return None


class _RingChannel(kombu_redis.Channel):
    def _get_client(self) -> Any:
        return partial(_RingClient, global_keyprefix=self.global_keyprefix)


class _RingTransport(kombu_redis.Transport):
    Channel = _RingChannel


class _RingConnection(Connection):
    """Whatever scheme the address has: `redis`, `rediss` and `redis+socket` share one transport."""

    def get_transport_cls(self) -> type[Transport]:
        found = super().get_transport_cls()
        return _RingTransport if found is kombu_redis.Transport else found


class RingAmqp(AMQP):
    """How the worker's Celery app speaks to the broker."""

    Connection = _RingConnection
