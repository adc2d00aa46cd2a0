"""What of each paper is reproduced: a list, figure by figure and table by table, and the stored results beside it."""
