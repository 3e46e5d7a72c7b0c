"""Celery's settings, one by one (docs/decisions/0003-sql-is-the-queue.md says why)."""

import pytest
from celery import Celery

from exceptiondrive_schemas.jobs import JobName, Lane
from exceptiondrive_worker.app import create_app
from exceptiondrive_worker.process import register_tasks
from exceptiondrive_worker.settings import WorkerSettings

BLOCK = {
    "task_acks_late": False,
    "task_reject_on_worker_lost": False,
    "task_ignore_result": True,
    "result_backend": None,
    "task_store_errors_even_if_ignored": False,
    "task_serializer": "json",
    "accept_content": ["json"],
    "worker_send_task_events": False,
    "task_send_sent_event": False,
    "worker_prefetch_multiplier": 1,
    "worker_disable_prefetch": True,
    "worker_concurrency": 2,
    "worker_pool": "prefork",
    "task_soft_time_limit": 75,
    "task_time_limit": 90,
    "worker_max_tasks_per_child": 100,
    "worker_max_memory_per_child": 600_000,
    "worker_cancel_long_running_tasks_on_connection_loss": False,
    "broker_connection_retry_on_startup": True,
    "broker_connection_max_retries": None,
    "task_publish_retry": True,
    "task_publish_retry_policy": {
        "max_retries": 2,
        "interval_start": 0,
        "interval_step": 0.2,
        "interval_max": 0.5,
    },
    "worker_hijack_root_logger": False,
    "worker_redirect_stdouts": False,
    "task_default_queue": "live",
    "task_create_missing_queues": False,
}
TRANSPORT = {
    "visibility_timeout": 300,
    "unacked_restore_interval": 5,
    "unacked_restore_throttle": 1,
    "socket_timeout": 5,
    "socket_connect_timeout": 5,
    "socket_keepalive": True,
    "health_check_interval": 10,
    "retry_on_timeout": True,
    "global_keyprefix": "ed:",
    "priority_steps": [0],
    "max_connections": 20,
    "queue_order_strategy": "sorted",
}


def app() -> Celery:
    return create_app(WorkerSettings(broker_url="redis://h/0"))


def test_the_app_has_every_setting_of_the_block() -> None:
    conf = app().conf
    assert {name: conf[name] for name in BLOCK} == BLOCK


def test_the_transport_has_every_option_of_the_block() -> None:
    assert app().conf.broker_transport_options == TRANSPORT


def test_there_are_two_lanes_and_live_sorts_first() -> None:
    assert [queue.name for queue in app().conf.task_queues] == ["live", "rescore"]
    assert min(Lane) is Lane.LIVE


@pytest.mark.parametrize("url", ["redis://h/0", "rediss://h/0", "redis+socket:///run/broker.sock"])
def test_junk_is_kept_from_celery_whatever_way_leads_to_the_broker(url: str) -> None:
    with create_app(WorkerSettings(broker_url=url)).connection_for_read() as connection:
        assert connection.get_transport_cls().__name__ == "_WakeTransport"


def test_nobody_commands_workers_through_the_broker() -> None:
    assert app().conf.worker_enable_remote_control is False


def test_the_app_has_all_tasks_by_name_and_no_result_backend() -> None:
    worker = app()
    register_tasks(worker, lambda: None)  # type: ignore[arg-type, return-value]
    own = {name for name in worker.tasks if not name.startswith("celery.")}
    assert own == {name.value for name in JobName}
    assert type(worker.backend).__name__ == "DisabledBackend"
