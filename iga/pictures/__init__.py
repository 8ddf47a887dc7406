"""Pictures of domains and fields, drawn off screen."""
