"""What every route and page stands on."""
