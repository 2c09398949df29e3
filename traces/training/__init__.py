"""Training jobs: their parameters, the waveform of one, and a site of several."""
