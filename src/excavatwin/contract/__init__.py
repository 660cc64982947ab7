"""What observations must satisfy, whoever made them: the contract of one view, and conventions seen across views."""
