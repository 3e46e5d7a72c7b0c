"""The Celery app and its message filter: wake-ups of a lane pass, junk is dropped when it is read.

Celery only distributes: the records are the queue. It trusts the contents of its queues, and Celery
5.7 ends the whole worker over one message that is not JSON, and reconnects over one without an
envelope; the supervisor would restart the worker within seconds, once per piece of junk. So foreign
messages (another program's data, a slip at the broker's prompt, damage in transit) are removed from
the queue and logged. Nothing is lost with a queue. The fields are those of Celery's message
protocol 2 in kombu's envelope. docs/decisions/0003-sql-is-the-queue.md explains the settings.

Uses only documented extension points: `Celery(amqp=...)`, `AMQP.Connection`, `Transport.Channel`,
and the client of a channel, which is redis-py's `Redis`.
"""

import base64
from functools import partial
from typing import Annotated, Any, Literal

import structlog
from celery import Celery
from celery.app.amqp import AMQP
from kombu import Connection
from kombu.transport import redis as kombu_redis
from kombu.transport.base import Transport
from kombu.utils.encoding import bytes_to_str
from kombu.utils.json import loads
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from exceptiondrive_records.work.dispatch import lane_queues, transport_options
from exceptiondrive_schemas.jobs import JobName, Lane
from exceptiondrive_worker.settings import WorkerSettings

_log = structlog.get_logger("exceptiondrive.worker")

MAX_MESSAGE_BYTES = 16 * 1024
"""A message that wakes a lane has about 900 bytes."""

_Nothing = Annotated[dict[str, object], Field(max_length=0)]
_Body = TypeAdapter(
    tuple[Annotated[list[str], Field(min_length=1, max_length=1)], _Nothing, dict[str, None]]
)
"""One name or id, no keyword arguments, and no follow-up tasks."""


class _Part(BaseModel):
    """Unknown fields are accepted, since newer releases of Celery add some, but not passed on."""

    model_config = ConfigDict(strict=True)


class _Delivery(_Part):
    exchange: str
    routing_key: str


class _Properties(_Part):
    delivery_tag: str
    delivery_info: _Delivery
    body_encoding: Literal["base64"]


class _Headers(_Part):
    """The task, to run now and within the usual limits: no delay, no time limit of its own."""

    id: str
    task: Annotated[JobName, Field(strict=False)]
    eta: None = None
    expires: None = None
    compression: None = None
    shadow: None = None
    timelimit: list[None] = []


class _Envelope(_Part):
    body: str
    content_type: Annotated[Literal["application/json"], Field(alias="content-type")]
    content_encoding: Annotated[Literal["utf-8"], Field(alias="content-encoding")]
    headers: _Headers
    properties: _Properties


def why_junk(message: bytes) -> str | None:
    """Say why a message is foreign, in words that quote nothing of it; None if it is sound."""
    if len(message) > MAX_MESSAGE_BYTES:
        return f"it has more than {MAX_MESSAGE_BYTES} bytes"
    try:
        document = loads(bytes_to_str(message))  # parsed as kombu does, so that kombu succeeds too
    except (ValueError, TypeError, AttributeError, ArithmeticError, RecursionError):
        return "it is not JSON"
    try:
        envelope = _Envelope.model_validate(document)
        envelope.model_dump_json()  # what cannot be serialized cannot be passed on
    except ValueError:
        return "it is not an envelope of a known message"
    try:
        _Body.validate_json(base64.b64decode(envelope.body, validate=True), strict=True)
    except ValueError:
        return "its body is not a list of ids"
    return None


def _declared_fields(message: bytes) -> bytes:
    """Return a sound message reduced to the validated fields.

    A single number in a field that Celery reads by itself (`stamped_headers`) ends a worker.
    """
    envelope = _Envelope.model_validate(loads(bytes_to_str(message)))
    return envelope.model_dump_json(by_alias=True, exclude_unset=True).encode()


class _WakeClient(kombu_redis.PrefixedStrictRedis):
    """Reads responses of the broker; one that holds junk is treated as empty."""

    def parse_response(self, connection: Any, command_name: str, **options: Any) -> Any:
        answer = super().parse_response(connection, command_name, **options)
        if command_name != "BRPOP" or not answer:
            return answer
        queue, message = answer
        reason = why_junk(message)
        if reason is None:
            return queue, _declared_fields(message)
        _log.warning(
            "junk dropped from a queue",
            queue=queue.decode(errors="replace"),
            size_bytes=len(message),
            reason=reason,
        )
        return None


class _WakeChannel(kombu_redis.Channel):
    def _get_client(self) -> Any:
        return partial(_WakeClient, global_keyprefix=self.global_keyprefix)


class _WakeTransport(kombu_redis.Transport):
    Channel = _WakeChannel


class _WakeConnection(Connection):
    """Uses one transport for all schemes of the address: `redis`, `rediss` and `redis+socket`."""

    def get_transport_cls(self) -> type[Transport]:
        found = super().get_transport_cls()
        return _WakeTransport if found is kombu_redis.Transport else found


class WakeAmqp(AMQP):
    """How the worker's Celery app talks to the broker."""

    Connection = _WakeConnection


def create_app(settings: WorkerSettings) -> Celery:
    """Return the app; `tests/chaos` shows that with these settings nothing is lost or doubled.

    Messages are acknowledged before the work: if it fails, the lease in the records brings it back.
    There is no result backend; a message takes ids and returns nothing. Junk in a queue is dropped,
    and remote control is off, so that nobody who can write to the broker can stop workers.
    """
    app = Celery("exceptiondrive", broker=settings.broker_url, amqp=WakeAmqp, set_as_current=False)
    app.conf.update(
        task_acks_late=False,
        task_reject_on_worker_lost=False,
        task_ignore_result=True,
        result_backend=None,
        task_store_errors_even_if_ignored=False,
        task_serializer="json",
        accept_content=["json"],
        worker_send_task_events=False,
        worker_enable_remote_control=False,
        task_send_sent_event=False,
        worker_prefetch_multiplier=1,
        worker_disable_prefetch=True,
        worker_concurrency=2,
        worker_pool="prefork",
        task_soft_time_limit=settings.soft_time_limit_s,
        task_time_limit=settings.time_limit_s,
        worker_max_tasks_per_child=100,
        worker_max_memory_per_child=600_000,  # KiB
        worker_cancel_long_running_tasks_on_connection_loss=False,
        broker_connection_retry_on_startup=True,
        broker_connection_max_retries=None,
        task_publish_retry=True,
        task_publish_retry_policy={
            "max_retries": 2,
            "interval_start": 0,
            "interval_step": 0.2,
            "interval_max": 0.5,
        },
        worker_hijack_root_logger=False,
        worker_redirect_stdouts=False,
        task_default_queue=Lane.LIVE.value,
        task_create_missing_queues=False,
        task_queues=lane_queues(),  # each with its own exchange: lanes must not hear each other
        # `sorted`: a worker of both lanes polls `live` before `rescore`
        broker_transport_options={**transport_options(), "queue_order_strategy": "sorted"},
    )
    return app
