"""The contract between asker (service) and worker: records, events, store and dispatch."""
