"""The library of waveforms: its file, its exports, and solving anew between its nodes."""
