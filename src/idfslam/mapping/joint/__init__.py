"""Maps that are optimised together with poses, as iMAP's and NICE-SLAM's are."""
