"""ImageDream (Wang and Shi, 2023), the diffusion model that the paper distils; its weights are the user's to bring."""
