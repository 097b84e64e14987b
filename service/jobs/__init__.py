"""What a job of the service is: its states, its request, its record."""
