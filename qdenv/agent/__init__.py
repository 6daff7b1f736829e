"""The maze agent: levels to train on, PPO, the trainer, the converter, the evaluation."""
