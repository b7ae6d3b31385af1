"""The library of waveforms: its file, its exports, and tap-by-tap solves between its nodes."""
