"""The Celery workers: they score uploads, build boards, and alone open withheld splits."""
