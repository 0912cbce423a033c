"""What every training shares: the loop, its schedule, checkpoints, several processes, and jobs from a YAML file."""
