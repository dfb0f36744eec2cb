"""An AWS Batch of our own, over HTTP: what moto lacks (several containers in a task, arrays, retries, lost hosts).

`server` answers the REST calls, each request and answer held against botocore's own service model (`model`); `calls`
has a function for each; `definitions` knows what Batch refuses; `jobs` the records and their states; `scheduler`
gives jobs a host, one attempt after the other. A task runs in real containers (`containers`) or is a function of the
test (`instant`). `faults` is all that goes wrong on demand.

It is our reading of AWS's documents. What it cannot prove: where and when AWS places a job, Spot, the network and the
disks of Fargate, IAM (any signed request is answered), quotas, the exact texts of messages.
"""
