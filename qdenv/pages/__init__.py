"""Pages to look at in a browser: one HTML file each with everything inside, no network."""
