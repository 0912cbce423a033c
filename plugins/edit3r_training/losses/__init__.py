"""The terms of the paper's objective (section 3.3); their weights are set in the training configuration.

The paper does not publish its weights: those in `configs/training` are this project's own.
"""
