"""Scene files of the figures of the thesis, with its settings; comments say what it leaves open."""
