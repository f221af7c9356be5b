"""The avatar: surfels in a canonical pose, the attribute field over them, and how a body moves them."""
