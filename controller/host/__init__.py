"""The host side of the serial link: session, upload, monitor, check."""
