"""touchnet: closed triangle meshes from touching trajectories."""
