"""The latent_planner agent."""
