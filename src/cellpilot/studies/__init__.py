"""Studies over many trainings, rewards or networks: ablation, sensitivity, adapt."""
