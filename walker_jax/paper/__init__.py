"""The paper of Schwab and Wisse (2001), figure by figure and number by number."""
