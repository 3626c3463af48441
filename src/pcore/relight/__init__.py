"""The light of the photos: lamps, shadows, their estimate, and surfels lit anew."""
