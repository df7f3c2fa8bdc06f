"""The front door: HTTP and websockets in front of the job queue and the store."""
