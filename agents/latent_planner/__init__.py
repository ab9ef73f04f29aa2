"""The paper's planner: MPPI in a learned latent space, guided by a learned policy."""
