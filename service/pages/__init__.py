"""Pages for people, served at ``/``: shells without data that read the public API.

A page is a template with the names from its path; its script fetches everything else from `/v1`
as any client would, with the key that was typed once where keys are needed. So pages need no key
themselves, tell nothing, and can do nothing that a key may not.
"""
