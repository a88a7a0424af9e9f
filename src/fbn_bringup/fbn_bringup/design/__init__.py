"""What a vehicle, a sonar and a sea can do together: for ``fbn design``."""
