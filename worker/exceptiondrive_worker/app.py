"""The Celery app. Celery only distributes: the records are the queue.

docs/decisions/0003-sql-is-the-queue.md gives the reason of each setting.
"""

from celery import Celery

from exceptiondrive_records.work.doorbell import lane_queues, transport_options
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_worker.ring_transport import RingAmqp
from exceptiondrive_worker.settings import WorkerSettings


def create_app(settings: WorkerSettings) -> Celery:
    """Return the app with settings that neither lose nor double a job.

    Jobs are acknowledged before they run: the lease in the records brings them back. There is no
    result backend; a job takes ids and returns nothing. Junk in a queue is dropped (`rings`), and
    nobody who can write to the broker can stop workers by its remote control.
    """
    app = Celery("exceptiondrive", broker=settings.broker_url, amqp=RingAmqp, set_as_current=False)
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
        # `sorted`: a worker of both lanes looks into `live` before `rescore`
        broker_transport_options={**transport_options(), "queue_order_strategy": "sorted"},
    )
    return app
