"""From onsets to tracks: cluster, predict, associate, update, initiate, delete."""
