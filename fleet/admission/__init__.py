"""Who may report: the certificate authority, enrolment over HTTPS, and the authorization callout of NATS."""
