"""What training algorithms share: configuration, a run's folder, batched environments, validation."""
