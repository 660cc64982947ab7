"""What observations must satisfy, whoever made them: the contract of one view, and conventions seen across views."""
# NOTE FROM THE LEAD TO OWNER G (09:05): helper I now writes backbones/conformance/, cli/check_backbone.py and the plugin
# example. You finish validate() here, the mutation tests and docs/validation.md by 09:35, and commit what stands at once.
