"""From field to mesh: band, crossings, dual vertices, cleaning, colour, export."""
