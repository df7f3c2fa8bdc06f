"""The workshop: processes that take jobs from the queue and reconstruct."""
