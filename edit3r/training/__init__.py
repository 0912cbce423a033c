"""What every training shares: the loop, its schedule, checkpoints and several processes."""
