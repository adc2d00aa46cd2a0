"""What a unit and a control centre agree on: batches, receipts, topics, identity."""
