"""What teams are told: an inbox each, and webhooks and e-mail besides."""
