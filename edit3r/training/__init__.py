"""What every training recipe needs and none should write again: checkpoints, stop signals, schedules, logs, jobs."""
