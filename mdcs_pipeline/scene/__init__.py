"""A scene that frames add up to: its voxels, its nodes and their graph, updated locally."""
