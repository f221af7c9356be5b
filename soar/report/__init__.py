"""Pictures, videos and pages made from results. Nothing here computes a result."""
