"""Called by Alembic: runs the migrations on the connection that `migrate` opened."""

from alembic import context

from exceptiondrive_records.db.base import Base

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=Base.metadata,
    transactional_ddl=False,  # `migrate` holds the only transaction
    render_as_batch=True,
)
context.run_migrations()
